"""Behavioural cloning from beginning to end, on small demonstrations."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from baselines.tests import tiny_runs
from baselines.tests.conftest import TASKS, picture_demo, write_demos
from baselines.tests.tiny_runs import checkpoint
from magical.demos import Trajectory, observations
from magical.evaluation import evaluate
from magical.physics import Simulation
from magical.scene.actions import POINTS
from magical.tasks import get_task
from magical_baselines import NetworkPolicy, load_policy, train
from magical_baselines.algorithms.bc import BCConfig, bc_loss


def tiny(demos: Path, **fields: Any) -> BCConfig:
    settings = {"tasks": TASKS[:1], "demos": str(demos), "batches": 6, "checkpoint_every": 2}
    return tiny_runs.tiny(BCConfig, **{**settings, **fields})


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


def test_loss_is_the_mean_negative_log_likelihood() -> None:
    logits = torch.zeros(2, 18)
    logits[0, 3] = 2.0
    first = torch.log(17 + torch.tensor(2.0).exp()) - 2.0
    expected = 0.5 * (first + torch.tensor(18.0).log())
    assert torch.allclose(bc_loss(logits, torch.tensor([3, 0])), expected)


def test_the_optimiser_gets_the_learning_rate_of_the_batch(demos: Path, tmp_path: Path) -> None:
    train(tiny(demos, batches=4, learning_rate=1e-3, anneal=True), tmp_path / "run")
    (group,) = checkpoint(tmp_path / "run")["optimizer"]["param_groups"]
    assert group["lr"] == pytest.approx(0.25e-3)


def test_state_vectors_are_learned_from(tmp_path: Path) -> None:
    task, actions = get_task("MoveToRegion"), np.repeat([1, 4], 16)
    simulation = Simulation(task.demo)
    bodies = [simulation.read()]
    for action in actions.tolist():
        simulation.step(POINTS[action])
        bodies.append(simulation.read())
    demo = Trajectory.from_bodies("MoveToRegion-Demo-v0", task.demo, actions, np.stack(bodies))
    demos = write_demos(tmp_path / "demos", [demo])
    fields = {"tasks": ("MoveToRegion",), "observation": "state", "num_demos": 1}
    config = tiny(demos, **fields, augment="none", batches=300, batch_size=16)
    train(config, tmp_path / "run")
    policy = load_policy(tmp_path / "run", greedy=True)
    states = observations(demo, "state")[:-1]
    found = policy.act(states, ["MoveToRegion-Demo-v0"] * len(states), np.random.default_rng(0))
    assert np.mean(found == actions) > 0.9
    assert len(evaluate(policy, ["MoveToRegion-Demo-v0"], rollouts=1, seed=0, workers=0)) == 1
