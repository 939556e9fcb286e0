"""Plans in processes that are killed: nothing is done twice, and the scores stay the same."""

import signal

import pytest

from baselines.tests.experiments.conftest import TIMEOUT, reached, running, scores_of
from magical.errors import WorkerDiedError
from magical.plugins import import_user_module
from magical.tasks import unregister_task
from magical_baselines.experiments.execution import Processes
from magical_baselines.experiments.plan import PlannedReference
from magical_baselines.experiments.status import read_status
from tests.waiting import soon


def records(out):
    """The final records, told from those written again by inode and time."""
    found = {path.parent.name: path.stat() for path in out.glob("runs/*/result.json")}
    return {name: (status.st_ino, status.st_mtime_ns) for name, status in found.items()}


def test_a_plan_that_is_killed_goes_on_with_the_same_scores(tiny, finished, out):
    before: dict[str, tuple[int, int]] = {}
    for moment in (3, 9):  # in the first run, in the second
        with running(tiny, out) as process:
            assert reached(out, moment)
            process.kill()
        assert before.items() <= records(out).items()
        before = records(out)
    with running(tiny, out) as process:
        assert process.wait(TIMEOUT) == 0
    assert before.items() <= records(out).items()
    assert scores_of(out) == scores_of(finished)


@pytest.mark.posix
def test_sigterm_leaves_a_checkpoint_and_exits_130(tiny, planned, out):
    folder = out / "runs" / planned()[0].folder
    with running(tiny, out) as process:
        assert reached(out, 1)
        process.send_signal(signal.SIGTERM)
        assert process.wait(TIMEOUT) == 130
        assert process.stderr is not None
        assert f"to continue: magical run {tiny} --out {out}" in process.stderr.read()
    assert (folder / "checkpoint.safetensors").is_file()
    status = read_status(out)
    assert (status.active, status.counts["failed"]) == (False, 0)


OUTSIDE = """
from dataclasses import replace
from magical.tasks import get_task
TASK = replace(get_task("MoveToRegion"), name="DriveHere", section="")
"""


@pytest.mark.posix
def test_a_process_that_is_killed_is_named_and_others_go_on(planned, out, tmp_path, monkeypatch):
    (tmp_path / "task_for_a_plan.py").write_text(OUTSIDE)
    monkeypatch.syspath_prepend(tmp_path)
    import_user_module("task_for_a_plan")  # known in the process, too
    processes = Processes([], 1)
    try:
        (run, *_) = planned(
            ('["MoveToRegion"]', '["task_for_a_plan:TASK"]\ndemos = "theirs"'),
            ("expert_demos = 3\n", ""),
        )
        noop = PlannedReference("noop", run.evaluation)
        killed, done = (processes.submit(noop, out / name, None) for name in ("killed", "done"))
        assert soon(lambda: bool(processes._children))
        next(iter(processes._children)).kill()
        with pytest.raises(WorkerDiedError, match=r"its process was killed by signal 9 \(SIGKILL"):
            killed.result()
        done.result()
        assert (out / "done" / "scores.csv").exists()
    finally:
        unregister_task("DriveHere")
        processes.close()
