"""Runs of any algorithm: logging, checkpoints, interruptions; random streams, batches ahead."""

import errno
import math
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping
from itertools import count
from pathlib import Path
from typing import Any

import pytest
import torch

from baselines.tests import tiny_runs
from baselines.tests.conftest import TASKS, picture_demo, write_demos
from baselines.tests.tiny_runs import assert_same, checkpoint, same_weights
from magical.errors import (
    CheckpointError,
    CheckpointMismatchError,
    DivergedError,
    InvalidConfigError,
    RunFolderError,
)
from magical.runs import CHECKPOINT, METRICS, read_metrics
from magical_baselines import Algorithm, load_policy, train
from magical_baselines.algorithms.bc import BCConfig
from magical_baselines.algorithms.bc import make_policy as bc_policy
from magical_baselines.compute import cpu_threads
from magical_baselines.config import CHECKPOINT_SECONDS
from magical_baselines.run_folder import opened_folder
from magical_baselines.training import (
    Interrupts,
    Purpose,
    Run,
    anneal,
    prefetch,
    seed_torch,
    seeded_init,
)

CONFIGURATION = BCConfig.preset("paper", tasks=("MoveToCorner",), demos="demos")


class Part:
    """What a run keeps: a state that tests change."""

    def __init__(self, **state: Any) -> None:
        self.state: dict[str, Any] = state

    def state_dict(self) -> dict[str, Any]:
        return self.state

    def load_state_dict(self, state: Any) -> None:
        self.state = state


def opened(folder: Path, checkpoint_every: int = 100, **options: Any) -> Run:
    return Run(folder, CONFIGURATION.replace(checkpoint_every=checkpoint_every), **options)


def finish(run: Run, step: int, last: bool = False, **metrics: float) -> bool:
    return run.finish_step(step, lambda: metrics, last=last)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    path = tmp_path / "run"
    with opened_folder(path, CONFIGURATION.to_dict(), resume=False):
        return path


def test_metrics_after_the_checkpoint_are_dropped_and_parts_restored(folder: Path) -> None:
    with opened(folder) as run:
        assert not run.keep(policy=Part(a=torch.ones(2)))
        finish(run, 1, last=True, loss=0.5)
        finish(run, 2, loss=0.25)
    with (folder / METRICS).open("a") as file:
        file.write('{"step": 3, "lo')
    assert [line["step"] for line in read_metrics(folder)] == [1, 2]
    part = Part()
    with opened(folder) as run:
        assert run.step == 1
        assert run.keep(policy=part)
        assert not run.keep(begun_later=Part())
        with pytest.raises(CheckpointMismatchError, match="another network or program"):
            run.keep(policy=part, optimizer=Part())  # which was kept with it
    assert torch.equal(part.state["a"], torch.ones(2))
    assert read_metrics(folder) == [{"step": 1, "loss": 0.5}]


def test_what_is_not_finite_is_logged_and_never_becomes_a_checkpoint(folder: Path) -> None:
    with opened(folder) as run:
        run.keep(policy=(part := Part()))
        finish(run, 5, last=True)
        for bad in ({"a": torch.tensor([1.0, math.inf])}, {"b": [{"c": math.nan}]}):
            part.state = bad
            with pytest.raises(DivergedError, match=r"at step 6 .*keeps the checkpoint of step 5"):
                finish(run, 6, last=True)
        with pytest.raises(DivergedError, match="at step 7"):
            finish(run, 7, loss=math.nan)
    assert read_metrics(folder)[-1] == {"step": 7, "loss": None}
    with opened(folder) as run:
        assert run.step == 5


def test_facts_may_not_change(folder: Path) -> None:
    with opened(folder) as run:
        run.describe(demonstrations=["a", "b"])
    with opened(folder) as run:
        run.describe(demonstrations=["a", "b"])
        with pytest.raises(RunFolderError, match=r"expected \['a', 'b'\], found \['a', 'c'\]"):
            run.describe(demonstrations=["a", "c"])


def test_precision_and_threads_are_chosen_once_and_kept(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with cpu_threads(0):
        with opened(folder) as run:
            chosen = run.compute
        assert chosen.threads == torch.get_num_threads()
        monkeypatch.setattr("magical_baselines.compute.has_bfloat16", lambda _: None)
        torch.set_num_threads(chosen.threads + 1)
        with opened(folder) as run:
            assert run.compute == chosen
        assert torch.get_num_threads() == chosen.threads


def test_checkpoints_are_due_by_number_or_by_time(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = 100.0
    monkeypatch.setattr("magical_baselines.training.time.monotonic", lambda: now)
    saved = []
    with opened(folder, checkpoint_every=3) as run:
        for step in range(1, 8):
            finish(run, step)
            saved.append(run.step)
    assert saved == [0, 0, 3, 3, 3, 6, 6]
    with opened(folder, checkpoint_every=0) as run:
        finish(run, 7)
        assert run.step == 6
        now += CHECKPOINT_SECONDS
        finish(run, 8)
        finish(run, 9)
        assert run.step == 8


def test_checkpoints_that_take_long_are_saved_less_often(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = 100.0
    monkeypatch.setattr("magical_baselines.training.time.monotonic", lambda: now)

    class Slow(Part):
        def state_dict(self) -> dict[str, Any]:
            nonlocal now
            now += 6.0
            return {}

    with opened(folder, checkpoint_every=0) as run:
        run.keep(policy=Slow())
        now += CHECKPOINT_SECONDS
        finish(run, 1)
        now += 119.0
        finish(run, 2)
        assert run.step == 1
        now += 1.0
        finish(run, 3)
        assert run.step == 3


def test_metrics_are_logged_every_so_many_steps_and_at_the_last(folder: Path) -> None:
    with opened(folder) as run:
        for step in range(1, 6):
            run.finish_step(step, dict, log_every=2, last=step == 5)
        assert run.step == 5
    assert [line["step"] for line in read_metrics(folder)] == [2, 4, 5]


def test_stop_after_counts_from_the_checkpoint(folder: Path) -> None:
    for steps in ((1, 2, 3), (4, 5, 6)):
        with opened(folder, stop_after=3) as run:
            assert [finish(run, step) for step in steps] == [False, False, True]
            assert run.step == steps[-1]


def test_a_precision_that_an_algorithm_would_ignore_is_refused(folder: Path) -> None:
    config = CONFIGURATION.replace(precision="bfloat16", device="cuda")
    with (
        Run(folder, config) as run,
        pytest.raises(InvalidConfigError, match="device cuda and precision bfloat16: this algorit"),
    ):
        finish(run, 1)
    assert read_metrics(folder) == []
    with cpu_threads(0), Run(folder, config.replace(device="cpu", threads=1)) as run:
        assert run.compute.precision == "bfloat16"
        finish(run, 1)


def test_threads_are_set_before_an_algorithm_is_called(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found: list[int] = []
    own = Algorithm(BCConfig, lambda config, run: found.append(torch.get_num_threads()), bc_policy)
    monkeypatch.setattr("magical_baselines.run.find_algorithm", lambda name: own)
    before = torch.get_num_threads()
    for threads in (1, 3):
        train(CONFIGURATION.replace(threads=threads), tmp_path / str(threads))
    assert found == [1, 3]
    assert torch.get_num_threads() == before


def test_learning_is_imported_without_pytorch() -> None:
    code = (
        "import sys, magical_baselines, magical_baselines.config, magical_baselines.networks; "
        "from magical.cli import build_parser; build_parser().format_help(); "
        "magical_baselines.algorithm_names(); sys.exit('torch' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


def tiny(demos: Path, **fields: Any) -> BCConfig:
    settings = {"tasks": TASKS[:1], "demos": str(demos), "batches": 6, "checkpoint_every": 2}
    return tiny_runs.tiny(BCConfig, **{**settings, **fields})


def call_at(at: int, act: Callable[[], None]) -> Callable[[int, Mapping[str, float | str]], None]:
    """A callback that calls `act` at one step."""

    def callback(step: int, metrics: Mapping[str, float | str]) -> None:
        if step == at:
            act()

    return callback


def test_the_callback_gets_every_line_of_metrics(demos: Path, tmp_path: Path) -> None:
    seen: list[dict[str, Any]] = []
    train(
        tiny(demos),
        tmp_path / "run",
        callback=lambda step, metrics: seen.append({"step": step, **metrics}),
    )
    rows = read_metrics(tmp_path / "run")
    assert [row.keys() for row in seen] == [row.keys() for row in rows]
    assert [row["loss"] for row in seen] == pytest.approx([row["loss"] for row in rows], abs=1e-6)


def test_what_the_callback_raises_ends_a_run_that_can_be_resumed(
    demos: Path, tmp_path: Path
) -> None:
    def prune() -> None:
        raise LookupError("pruned")

    with pytest.raises(LookupError, match="pruned"):
        train(tiny(demos), tmp_path / "run", callback=call_at(4, prune))
    assert train(tiny(demos), tmp_path / "run", resume=True).finished
    train(tiny(demos), tmp_path / "whole")
    assert same_weights(tmp_path / "run", tmp_path / "whole")


def test_stopping_after_no_step_is_refused(demos: Path, tmp_path: Path) -> None:
    with pytest.raises(InvalidConfigError, match="stop_after: expected a positive number, found 0"):
        train(tiny(demos), tmp_path / "run", stop_after=0)


def test_a_damaged_checkpoint_is_refused(demos: Path, tmp_path: Path) -> None:
    config, folder = tiny(demos), tmp_path / "run"
    train(config, folder, stop_after=4)
    damaged = (folder / CHECKPOINT).read_bytes()[:-100]
    (folder / CHECKPOINT).write_bytes(damaged)
    with pytest.raises(CheckpointError, match=r"checkpoint\.safetensors is damaged"):
        load_policy(folder)
    with pytest.raises(CheckpointError, match=r"checkpoint\.safetensors is damaged"):
        train(config, folder, resume=True)
    assert (folder / CHECKPOINT).read_bytes() == damaged


def test_a_run_is_trained_once_at_a_time_and_evaluated_meanwhile(
    demos: Path, tmp_path: Path
) -> None:
    config, folder = tiny(demos), tmp_path / "run"
    seen = []

    def meanwhile() -> None:
        for resume in (False, True):
            with pytest.raises(RunFolderError, match="another process already trains this run"):
                train(config, folder, resume=resume)
        seen.append(load_policy(folder).tasks)
        seen.append(read_metrics(folder)[-1]["step"])

    assert train(config, folder, callback=call_at(4, meanwhile)).finished
    assert seen == [("MoveToCorner",), 4]
    assert train(config, folder, resume=True).finished


KILLED = """
import os, pathlib, signal, sys
from magical_baselines import train
from magical_baselines import read_config
from magical.files import write_atomically

def die(step, metrics):
    if step == 4:
        with write_atomically(pathlib.Path(sys.argv[2]) / "checkpoint.safetensors") as file:
            file.write(b"half")
            file.flush()
            os.kill(os.getpid(), signal.SIGKILL)

train(read_config(pathlib.Path(sys.argv[1])), sys.argv[2], callback=die)
"""


@pytest.mark.posix
def test_a_killed_run_leaves_no_lock_and_its_partial_files_are_removed(
    demos: Path, tmp_path: Path
) -> None:
    config, folder = tiny(demos, threads=1), tmp_path / "run"
    train(config, tmp_path / "whole")
    command = [sys.executable, "-c", KILLED, str(tmp_path / "whole"), str(folder)]
    assert subprocess.run(command).returncode == -signal.SIGKILL
    assert len(list(folder.glob(".checkpoint.safetensors.*.part"))) == 1
    (folder / ".notes.txt.1.part").touch()  # of another program
    assert train(config, folder, resume=True).finished
    assert [path.name for path in folder.glob(".*.part")] == [".notes.txt.1.part"]
    assert same_weights(folder, tmp_path / "whole")


@pytest.mark.posix
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_leave_a_checkpoint_to_go_on_from(
    number: signal.Signals, demos: Path, tmp_path: Path
) -> None:
    config = tiny(demos, checkpoint_every=100)
    interrupt = call_at(2, lambda: os.kill(os.getpid(), number))
    result = train(config, tmp_path / "run", callback=interrupt)
    assert result.interrupted
    assert 2 <= result.step < 6
    assert signal.getsignal(number) is not None
    train(config, tmp_path / "run", resume=True)
    train(config, tmp_path / "whole")
    assert same_weights(tmp_path / "run", tmp_path / "whole")


@pytest.mark.posix
def test_a_second_interrupt_stops_at_once(demos: Path, tmp_path: Path) -> None:
    def twice() -> None:
        os.kill(os.getpid(), signal.SIGINT)
        os.kill(os.getpid(), signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        train(tiny(demos), tmp_path / "run", callback=call_at(2, twice))


def test_divergence_stops_and_keeps_the_last_good_checkpoint(demos: Path, tmp_path: Path) -> None:
    config = tiny(demos, optimizer="sgd", learning_rate=1e30, log_every=1, checkpoint_every=1)
    with pytest.raises(DivergedError, match="diverged: at step"):
        train(config, tmp_path / "run")
    newest = read_metrics(tmp_path / "run")[-1]
    assert newest["step"] > 1 or newest["loss"] is None
    if (tmp_path / "run" / CHECKPOINT).exists():
        policy = checkpoint(tmp_path / "run")["policy"]
        assert all(torch.isfinite(tensor).all() for tensor in policy.values())


def test_a_full_disk_is_named_and_the_last_checkpoint_kept(
    demos: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = tiny(demos)
    train(config, tmp_path / "run", stop_after=2)
    before = checkpoint(tmp_path / "run")

    def full(*_: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr("magical_baselines.training.save_checkpoint", full)
        with pytest.raises(RunFolderError, match=r"no space left.*resume"):
            train(config, tmp_path / "run", resume=True)
    assert_same(checkpoint(tmp_path / "run"), before)
    assert train(config, tmp_path / "run", resume=True).finished


def test_other_demonstrations_cannot_continue_a_run(demos: Path, tmp_path: Path) -> None:
    config = tiny(demos)
    train(config, tmp_path / "run", stop_after=2)
    others = [picture_demo("MoveToCorner", seed) for seed in range(10, 14)]
    moved = config.replace(demos=str(write_demos(tmp_path / "others", others)))
    with pytest.raises(RunFolderError, match="other demonstrations"):
        train(moved, tmp_path / "run", resume=True)


def test_a_handler_that_is_not_pythons_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    before = signal.getsignal(signal.SIGTERM)
    monkeypatch.setattr(signal, "getsignal", lambda _: None)  # as in R or Julia
    with Interrupts():
        monkeypatch.undo()
        assert signal.getsignal(signal.SIGTERM) is before


def test_the_learning_rate_falls_to_0_also_where_a_recorded_step_reads_it() -> None:
    for rate in (0.5, torch.tensor(0.5)):
        optimizer = torch.optim.Adam(torch.nn.Linear(2, 1).parameters(), 0.5, fused=True)
        optimizer.param_groups[0]["lr"] = rate
        lefts, rates = [], []
        for step in range(4):
            lefts.append(anneal(optimizer, step, 4))
            rates.append(float(optimizer.param_groups[0]["lr"]))
        assert lefts == [1.0, 0.75, 0.5, 0.25]
        assert rates == [0.5, 0.375, 0.25, 0.125]
        assert (optimizer.param_groups[0]["lr"] is rate) == isinstance(rate, torch.Tensor)


def alive() -> int:
    return sum(thread.name.startswith("batches") for thread in threading.enumerate())


@pytest.mark.parametrize("ahead", [True, False])
def test_batches_come_in_order(ahead: bool) -> None:
    with prefetch(lambda n: n * n, range(20), ahead) as batches:
        assert list(batches) == [n * n for n in range(20)]


def test_errors_reach_the_learner_and_the_thread_ends() -> None:
    def make(number: int) -> int:
        if number == 3:
            raise ValueError("no batch 3")
        return number

    with prefetch(make, range(9), True) as batches:
        assert [next(batches) for _ in range(3)] == [0, 1, 2]
        with pytest.raises(ValueError, match="no batch 3"):
            next(batches)
    assert alive() == 0


def test_leaving_early_ends_the_thread() -> None:
    with prefetch(lambda n: n, count(), True) as batches:
        assert next(batches) == 0
    assert alive() == 0


def test_the_thread_computes_alone_and_the_learner_keeps_its_cores() -> None:
    torch.set_num_threads(2)
    with prefetch(lambda _: torch.get_num_threads(), range(2), True) as batches:
        assert list(batches) == [1, 1]
        assert torch.get_num_threads() == 2
    assert torch.get_num_threads() == 2
    torch.set_num_threads(1)


def test_an_initialisation_is_the_same_while_another_thread_trains() -> None:
    done = threading.Event()

    def train() -> None:
        while not done.is_set():
            seed_torch(1, Purpose.NOISE)

    def initialise() -> torch.Tensor:
        with seeded_init(0):
            return torch.cat([torch.randn(1000) for _ in range(100)])

    alone = initialise()
    thread = threading.Thread(target=train)
    thread.start()
    try:
        assert all(torch.equal(initialise(), alone) for _ in range(5))
    finally:
        done.set()
        thread.join()
