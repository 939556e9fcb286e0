"""Behavioural cloning from beginning to end, on small demonstrations."""

import errno
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from magical.demos import Trajectory, observations
from magical.errors import CheckpointError, DivergedError, InvalidConfigError, RunFolderError
from magical.evaluation import evaluate
from magical.learning import NetworkPolicy, load_policy, train
from magical.learning.algorithms.bc import (
    BCConfig,
    BCTrainer,
    bc_loss,
)
from magical.learning.running import run
from magical.learning.running.run import Run
from magical.physics import Simulation
from magical.runs import read_metrics
from magical.runs.folder import CHECKPOINT
from magical.tasks import get_task
from tests.learning import tiny_runs
from tests.learning.conftest import TASKS, picture_demo, write_demos
from tests.learning.tiny_runs import assert_same, checkpoint, same_weights


def tiny(demos: Path, **fields: Any) -> BCConfig:
    settings = {"tasks": TASKS[:1], "demos": str(demos), "batches": 6, "checkpoint_every": 2}
    return tiny_runs.tiny(BCConfig, **{**settings, **fields})


def test_resumed_runs_are_bit_equal(demos: Path, tmp_path: Path) -> None:
    config = tiny(demos, precision="bfloat16", optimizer="adam", tasks=TASKS, augment="all")
    whole = train(config, tmp_path / "whole")
    assert whole.finished
    first = train(config, tmp_path / "parts", stop_after=3)
    assert (first.step, first.finished, first.interrupted) == (3, False, False)
    second = train(config, tmp_path / "parts", resume=True, stop_after=1)
    assert second.step == 4
    last = train(config, tmp_path / "parts", resume=True)
    assert last.finished
    assert same_weights(tmp_path / "whole", tmp_path / "parts")
    steps = [line["step"] for line in read_metrics(tmp_path / "parts")]
    assert steps == [2, 3, 4, 6]
    again = train(config, tmp_path / "parts", resume=True)
    assert again.finished
    assert same_weights(tmp_path / "whole", tmp_path / "parts")


def test_one_demonstration_is_overfitted(tmp_path: Path) -> None:
    demos = write_demos(tmp_path / "demos", [picture_demo("MoveToCorner", 0)])
    config = tiny(demos, num_demos=1, batches=80, batch_size=16, augment="none")
    trained = train(config, tmp_path / "run").policy()
    assert isinstance(trained, NetworkPolicy)
    trajectory = picture_demo("MoveToCorner", 0)
    shown = observations(trajectory, "LoRes4E")
    likeliest = trained.probabilities(shown, [trajectory.env_id] * len(shown)).argmax(axis=1)
    kept = trajectory.actions != 0
    assert (likeliest[:-1] == trajectory.actions)[kept].mean() >= 0.99


def test_it_learns_what_can_be_learned_through_all_augmentations(
    demos: Path, tmp_path: Path
) -> None:
    config = tiny(demos, num_demos=4, batches=90, batch_size=8, augment="all", log_every=30)
    train(config, tmp_path / "run")
    losses = [line["loss"] for line in read_metrics(tmp_path / "run")]
    assert losses[-1] < 0.5 * losses[0]


def test_loss_is_the_mean_negative_log_likelihood() -> None:
    logits = torch.zeros(2, 18)
    logits[0, 3] = 2.0
    first = torch.log(17 + torch.tensor(2.0).exp()) - 2.0
    expected = 0.5 * (first + torch.tensor(18.0).log())
    assert torch.allclose(bc_loss(logits, torch.tensor([3, 0])), expected)


def test_mirrored_samples_have_mirrored_labels(tmp_path: Path) -> None:
    task, left, right = "MoveToRegion", 3, 6
    config = tiny(tmp_path, tasks=(task,), augment="none", transform="mirror", batch_size=16)
    with Run(tmp_path, config) as folder:
        trainer = BCTrainer(config, folder)
        data = trainer.expert_data(((task, picture_demo(task, 0, [left] * 6)),))
        images, labels, _ = trainer.sample_batch(data, 0)
    corners = (images * 255).round() == left * 14  # dark in the upper left half, unless mirrored
    is_left = corners[:, :, :48, :48].flatten(1).all(dim=1)
    assert labels.tolist() == torch.where(is_left, left, right).tolist()
    assert set(labels.tolist()) == {left, right}


def test_the_learning_rate_is_constant_or_annealed_to_0(demos: Path) -> None:
    for anneal, expected in ((False, [1e-3, 1e-3, 1e-3]), (True, [1e-3, 5e-4, 0.0])):
        config = tiny(demos, batches=10, anneal=anneal)
        assert [config.learning_rate_at(n) for n in (0, 5, 10)] == pytest.approx(expected)
    assert not BCConfig.preset("paper", tasks=("FindDupe",), demos="d").cloning.anneal


def test_the_optimiser_gets_the_learning_rate_of_the_batch(demos: Path, tmp_path: Path) -> None:
    train(tiny(demos, batches=4, learning_rate=1e-3, anneal=True), tmp_path / "run")
    (group,) = checkpoint(tmp_path / "run")["optimizer"]["param_groups"]
    assert group["lr"] == pytest.approx(0.25e-3)


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
            with pytest.raises(RunFolderError, match=rf"process {os.getpid()} .*trains this run"):
                train(config, folder, resume=resume)
        seen.append(load_policy(folder).tasks)
        seen.append(read_metrics(folder)[-1]["step"])

    assert train(config, folder, callback=call_at(4, meanwhile)).finished
    assert seen == [("MoveToCorner",), 4]
    assert train(config, folder, resume=True).finished


KILLED = """
import os, pathlib, signal, sys
from magical.learning import train
from magical.learning.algorithms import read_config
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
        patch.setattr(run, "save_checkpoint", full)
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


def test_state_vectors_are_learned_from(tmp_path: Path) -> None:
    task, actions = get_task("MoveToRegion"), np.repeat([1, 4], 16)
    simulation = Simulation(task.demo)
    poses = [simulation.poses().bodies]
    for action in actions.tolist():
        simulation.step(action)
        poses.append(simulation.poses().bodies)
    demo = Trajectory.from_poses("MoveToRegion-Demo-v0", task.demo, actions, np.stack(poses))
    demos = write_demos(tmp_path / "demos", [demo])
    fields = {"tasks": ("MoveToRegion",), "observation": "state", "num_demos": 1}
    config = tiny(demos, **fields, augment="none", batches=300, batch_size=16)
    train(config, tmp_path / "run")
    policy = load_policy(tmp_path / "run", greedy=True)
    states = observations(demo, "state")[:-1]
    found = policy.act(states, ["MoveToRegion-Demo-v0"] * len(states), np.random.default_rng(0))
    assert np.mean(found == actions) > 0.9
    (score,) = evaluate(policy, ["MoveToRegion-Demo-v0"], rollouts=1, seed=0, workers=0)
    assert 0.0 <= score.score <= 1.0


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"augment": "noise"}, "augment: expected none"),
        ({"augment": "none", "tasks": TASKS}, "one task is expected"),
        ({"augment": "none", "augment_by": "rendering"}, "state vectors are not rendered"),
    ],
)
def test_state_vectors_need_other_settings(fields: dict[str, Any], message: str) -> None:
    with pytest.raises(InvalidConfigError, match=message):
        tiny(Path("demos"), observation="state", **fields)


def test_rendered_states_are_recorded_only_if_states_were_rendered(
    demos: Path, expert_demos: Path, tmp_path: Path
) -> None:
    given = {"transform": "palette", "num_demos": 2}
    for name, config, expected in (
        ("frames", tiny(demos, **given), ["demonstrations"]),
        ("poses", tiny(expert_demos, tasks=("FixColour",), **given),
         ["demonstrations", "rendered states"]),
    ):  # fmt: skip
        train(config, tmp_path / name)
        assert load_policy(tmp_path / name).record["learned_from"] == expected
