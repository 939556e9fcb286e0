"""Runs of any algorithm: logging, checkpoints, interruptions, trackers, batches ahead."""

import errno
import math
import os
import signal
import subprocess
import sys
import threading
from contextlib import closing, suppress
from typing import Any

import pytest
import torch
from hypothesis import given, settings
from hypothesis.strategies import binary, data, integers, lists

from baselines.tests import tiny_runs
from baselines.tests.conftest import TASKS, picture_demo, write_demos
from baselines.tests.tiny_runs import assert_same, checkpoint, same_weights, tiny
from magical.errors import (
    CheckpointError,
    DivergedError,
    InvalidConfigError,
    MissingDependencyError,
    RunFolderError,
)
from magical.runs import CHECKPOINT, METRICS, read_metrics
from magical_baselines import load_policy, train
from magical_baselines.algorithms.bc import BCConfig
from magical_baselines.run_folder import opened_folder
from magical_baselines.training import Run, load_checkpoint, prefetch, save_checkpoint

CONFIGURATION = BCConfig.preset("paper", tasks=("MoveToCorner",), demos="demos")


class Part:
    """What a run keeps: a state that tests change."""

    def __init__(self, **state):
        self.state: dict[str, Any] = state

    def state_dict(self):
        return self.state

    def load_state_dict(self, state):
        self.state = state


def opened(folder, checkpoint_every=100, **options):
    return Run(folder, CONFIGURATION.replace(checkpoint_every=checkpoint_every), **options)


def finish(run, step, last=False, **metrics):
    return run.finish_step(step, lambda: metrics, last=last)


@pytest.fixture
def folder(tmp_path):
    path = tmp_path / "run"
    with opened_folder(path, CONFIGURATION.to_dict(), resume=False):
        return path


def test_metrics_after_the_checkpoint_are_dropped_and_parts_restored(folder):
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
        with pytest.raises(CheckpointError, match="another network or program"):
            run.keep(policy=part, optimizer=Part())  # which was kept with it
    assert torch.equal(part.state["a"], torch.ones(2))
    assert read_metrics(folder) == [{"step": 1, "loss": 0.5}]


def test_what_is_not_finite_is_logged_and_never_becomes_a_checkpoint(folder):
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


def test_learning_is_imported_without_pytorch():
    code = (
        "import sys, magical_baselines, magical_baselines.config, magical_baselines.networks; "
        "from magical.cli import build_parser; build_parser().format_help(); "
        "magical_baselines.algorithm_names(); sys.exit('torch' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


def bc_config(demos, **fields):
    settings = {"tasks": TASKS[:1], "demos": str(demos), "batches": 6, "checkpoint_every": 2}
    return tiny_runs.tiny(BCConfig, **{**settings, **fields})


def call_at(at, act):
    """A callback that calls `act` at one step."""

    def callback(step, metrics):
        if step == at:
            act()

    return callback


def test_what_the_callback_raises_ends_a_run_that_can_be_resumed(demos, tmp_path):
    def prune():
        raise LookupError("pruned")

    with pytest.raises(LookupError, match="pruned"):
        train(bc_config(demos), tmp_path / "run", callback=call_at(4, prune))
    assert train(bc_config(demos), tmp_path / "run", resume=True).finished
    train(bc_config(demos), tmp_path / "whole")
    assert same_weights(tmp_path / "run", tmp_path / "whole")


def test_a_damaged_checkpoint_is_refused(demos, tmp_path):
    config, folder = bc_config(demos), tmp_path / "run"
    train(config, folder, stop_after=4)
    damaged = (folder / CHECKPOINT).read_bytes()[:-100]
    (folder / CHECKPOINT).write_bytes(damaged)
    with pytest.raises(CheckpointError, match=r"checkpoint\.safetensors is damaged"):
        load_policy(folder)
    with pytest.raises(CheckpointError, match=r"checkpoint\.safetensors is damaged"):
        train(config, folder, resume=True)
    assert (folder / CHECKPOINT).read_bytes() == damaged


def test_a_run_is_trained_once_at_a_time_and_evaluated_meanwhile(demos, tmp_path):
    config, folder = bc_config(demos), tmp_path / "run"
    seen = []

    def meanwhile():
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
def test_a_killed_run_leaves_no_lock_and_its_partial_files_are_removed(demos, tmp_path):
    config, folder = bc_config(demos, threads=1), tmp_path / "run"
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
def test_signals_leave_a_checkpoint_to_go_on_from(number, demos, tmp_path):
    config = bc_config(demos, checkpoint_every=100)
    interrupt = call_at(2, lambda: os.kill(os.getpid(), number))
    result = train(config, tmp_path / "run", callback=interrupt)
    assert result.interrupted
    assert 2 <= result.step < 6
    assert signal.getsignal(number) is not None
    train(config, tmp_path / "run", resume=True)
    train(config, tmp_path / "whole")
    assert same_weights(tmp_path / "run", tmp_path / "whole")


def test_a_full_disk_is_named_and_the_last_checkpoint_kept(demos, tmp_path, monkeypatch):
    config = bc_config(demos)
    train(config, tmp_path / "run", stop_after=2)
    before = checkpoint(tmp_path / "run")

    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr("magical_baselines.training.save_checkpoint", full)
        with pytest.raises(RunFolderError, match=r"no space left.*resume"):
            train(config, tmp_path / "run", resume=True)
    assert_same(checkpoint(tmp_path / "run"), before)
    assert train(config, tmp_path / "run", resume=True).finished


def test_other_demonstrations_cannot_continue_a_run(demos, tmp_path):
    config = bc_config(demos)
    train(config, tmp_path / "run", stop_after=2)
    others = [picture_demo("MoveToCorner", seed) for seed in range(10, 14)]
    moved = config.replace(demos=str(write_demos(tmp_path / "others", others)))
    with pytest.raises(RunFolderError, match="other demonstrations"):
        train(moved, tmp_path / "run", resume=True)


def test_errors_reach_the_learner_and_the_thread_ends():
    def make(number):
        if number == 3:
            raise ValueError("no batch 3")
        return number

    with closing(prefetch(make, range(9), True)) as batches:
        assert [next(batches) for _ in range(3)] == [0, 1, 2]
        with pytest.raises(ValueError, match="no batch 3"):
            next(batches)
    assert not [t for t in threading.enumerate() if t.name.startswith("batches")]


def test_the_thread_computes_alone_and_the_learner_keeps_its_cores():
    torch.set_num_threads(2)
    with closing(prefetch(lambda _: torch.get_num_threads(), range(2), True)) as batches:
        assert list(batches) == [1, 1]
        assert torch.get_num_threads() == 2
    assert torch.get_num_threads() == 2
    torch.set_num_threads(1)


def test_state_dicts_are_read_as_they_were_written(tmp_path):
    image = torch.rand(2, 3, 4, 5).to(memory_format=torch.channels_last)
    state = {
        "a": {"weights": image, "count": torch.tensor(3)},
        "list": [1, 2.5, None, True, torch.arange(4)],
        "rng": {"state": 2**127 + 1},
        "text": "x",
    }
    save_checkpoint(tmp_path / "c", state)
    back = load_checkpoint(tmp_path / "c")
    assert torch.equal(back["a"]["weights"], image)
    assert back["a"]["count"].shape == ()
    assert back["list"][:4] == [1, 2.5, None, True]
    assert torch.equal(back["list"][4], torch.arange(4))
    assert (back["rng"], back["text"]) == (state["rng"], "x")
    assert [file.name for file in tmp_path.iterdir()] == ["c"]


def test_missing_and_foreign_files_are_named(tmp_path):
    path = tmp_path / "c"
    with pytest.raises(CheckpointError, match="expected a readable file, found No such file"):
        load_checkpoint(path)
    for damaged in (b"", b"\x80\x04K\x01."):
        path.write_bytes(damaged)
        with pytest.raises(CheckpointError, match=r"c is damaged"):
            load_checkpoint(path)


@settings(deadline=None)  # a busy machine takes longer
@given(data())
def test_damaged_bytes_are_refused_or_read(tmp_path_factory, draw):
    path = tmp_path_factory.mktemp("damaged") / "c"
    save_checkpoint(path, {"a": {"weight": torch.ones(4, 3), "step": torch.tensor(5)}, "step": 3})
    raw = path.read_bytes()
    start, end = sorted(draw.draw(lists(integers(0, len(raw)), min_size=2, max_size=2)))
    path.write_bytes(raw[:start] + draw.draw(binary(max_size=40)) + raw[end:])
    with suppress(CheckpointError):
        load_checkpoint(path)


class Wandb:
    """Stands for the library and its sessions: keeps what its functions are called with."""

    def __init__(self):
        self.opened: list[dict[str, Any]] = []
        self.logged: list[tuple[int, dict[str, float]]] = []

    def init(self, **arguments):
        self.opened.append(arguments)
        return self

    def __enter__(self):
        return self

    def __exit__(self, *error): ...

    def log(self, metrics, step):
        self.logged.append((step, metrics))


def train_in_two_sessions(demos, run, tracker):
    config = tiny(BCConfig, demos=str(demos))
    train(config, run, track=[tracker], stop_after=2)
    train(config, run, track=[tracker], resume=True)
    return config


def test_a_session_of_wandb_continues_the_run(demos, tmp_path, monkeypatch):
    wandb = Wandb()
    monkeypatch.setitem(sys.modules, "wandb", wandb)
    monkeypatch.delenv("WANDB_PROJECT", raising=False)
    config = train_in_two_sessions(demos, tmp_path / "run", "wandb")
    first, second = wandb.opened
    assert first == second  # so that the second continues the first
    assert (first["name"], first["project"], first["resume"], first["config"]) == (
        ("run", "magical", "allow", config.to_dict())
    )
    assert [step for step, _ in wandb.logged] == [2, 4]
    assert {"loss", "accuracy"} < wandb.logged[0][1].keys()


def test_tensorboard_gets_the_metrics(demos, tmp_path):
    pytest.importorskip("tensorboard")
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    train_in_two_sessions(demos, tmp_path / "run", "tensorboard")
    events = EventAccumulator(str(tmp_path / "run" / "tensorboard"))
    events.Reload()
    assert [event.step for event in events.Scalars("loss")] == [2, 4]


def test_unknown_and_missing_trackers_are_named(demos, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "wandb", None)
    config = tiny(BCConfig, demos=str(demos))
    with pytest.raises(InvalidConfigError, match="expected tensorboard or wandb, found 'aim'"):
        train(config, tmp_path / "run", track=["aim"])
    with pytest.raises(MissingDependencyError, match=r"tracker wandb.*pip install wandb"):
        train(config, tmp_path / "run", track=["wandb"])
    assert not (tmp_path / "run").exists()
