"""Plans in processes that are killed: nothing is done twice, and the scores stay the same."""

import random
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from baselines.baselines.baselines.baselines.tests.experiments import processes
from baselines.baselines.baselines.baselines.tests.experiments.processes import (
    TIMEOUT,
    lines,
    reached,
    running,
    scores_of,
)

from magical.errors import WorkerDiedError
from magical_baselines.experiments import demonstrations
from magical_baselines.experiments.execution import Resources, execute
from magical_baselines.experiments.plan import PlannedRun
from magical_baselines.experiments.status import read_status

BATCHES = 6  # of each run


def records(out: Path) -> dict[str, tuple[int, int]]:
    """The final records, told from those written again by inode and time."""
    found = {path.parent.name: path.stat() for path in out.glob("runs/*/result.json")}
    return {name: (status.st_ino, status.st_mtime_ns) for name, status in found.items()}


def test_killed_three_times_the_scores_are_the_same_and_no_run_is_done_twice(
    tiny: Path, finished: Path, out: Path
) -> None:
    everything = lines(finished)
    assert everything == 2 * (BATCHES + 1)
    moments = sorted(random.Random(0).sample(range(1, everything), 3))
    before: dict[str, tuple[int, int]] = {}
    for moment in moments:
        with running(tiny, out) as process:
            assert reached(out, moment)
            process.kill()
        now = records(out)
        assert before.items() <= now.items()
        before = now
    with running(tiny, out) as process:
        assert process.wait(TIMEOUT) == 0
    assert before.items() <= records(out).items()
    assert len(records(out)) == 2
    assert scores_of(out) == scores_of(finished)


@pytest.mark.posix
def test_sigterm_leaves_a_checkpoint_and_exits_130(
    tiny: Path, planned: Callable[..., list[PlannedRun]], out: Path
) -> None:
    folder = out / "runs" / planned()[0].folder
    with running(tiny, out) as process:
        assert reached(out, 1)
        process.send_signal(signal.SIGTERM)
        assert process.wait(TIMEOUT) == 130
        assert process.stderr is not None
        assert "run the same command again" in process.stderr.read()
    assert (folder / "checkpoint.safetensors").is_file()
    status = read_status(out)
    assert not status.active
    assert status.counts["failed"] == 0


def test_a_killed_process_costs_what_it_was_doing_and_no_more(
    planned: Callable[..., list[PlannedRun]], out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    runs = planned()
    for part in ("finish", "evaluate_reference"):
        monkeypatch.setattr(
            f"magical_baselines.experiments.execution.{part}", getattr(processes, part)
        )
    generated = demonstrations.generate_missing

    def killed_once(*args: Any, **kwargs: Any) -> None:
        monkeypatch.setattr(demonstrations, "generate_missing", generated)
        raise WorkerDiedError("a worker process was killed")

    monkeypatch.setattr(demonstrations, "generate_missing", killed_once)
    references = [(name, runs[0].evaluation) for name in ("noop", "random")]
    with pytest.raises(WorkerDiedError, match=r"9 \(SIGKILL\) while it evaluated noop-Move.*again"):
        execute(runs, out, Resources(workers=2), references=references)
    assert [run.state for run in read_status(out).runs] == ["failed", "done"]
    assert "killed by signal 9" in read_status(out).runs[0].error
    assert (out / "references" / "random-MoveToRegion").is_dir()
