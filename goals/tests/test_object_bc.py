"""Object-centred behavioural cloning from beginning to end, in the smallest runs."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from torch.nn.functional import cross_entropy

from baselines.tests import tiny_runs
from baselines.tests.tiny_runs import assert_same, checkpoint
from magical.demos import observations
from magical.demos.generate import demonstrate
from magical.errors import InvalidConfigError
from magical.evaluation import evaluate
from magical.runs import read_metrics
from magical.scene import Action, Turn
from magical.tasks import get_task, register_task, unregister_task
from magical_baselines import load_policy, train
from magical_goals import object_bc
from magical_goals.object_bc import ObjectBCConfig
from magical_goals.objects.control import control_inputs, to_table
from magical_goals.objects.data import ObjectData
from magical_goals.objects.parser import parse_frames

TASKS = ("MoveToRegion", "FixColour")


@pytest.fixture(scope="module", autouse=True)
def small_updates_of_the_goal_model():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(object_bc, "GOAL_EVERY", 2)
        patch.setattr(object_bc, "GOAL_BATCH_SIZE", 4)
        yield


def tiny(demos, **fields):
    settings = {"tasks": TASKS, "demos": str(demos), "batches": 6, "batch_size": 8}
    return tiny_runs.tiny(ObjectBCConfig, "paper", **{**settings, **fields})


def test_tasks_with_more_objects_than_are_found_are_refused(tmp_path):
    register_task(replace(get_task("MoveToRegion"), name="Many", max_blocks=11))
    try:
        with pytest.raises(
            InvalidConfigError, match=r"Many: expected at most 10 blocks .* found 11"
        ):
            tiny(tmp_path, tasks=("Many",))
    finally:
        unregister_task("Many")


@pytest.fixture(scope="module")
def whole(expert_demos, tmp_path_factory):
    """A run that was never stopped."""
    folder = tmp_path_factory.mktemp("object-bc") / "run"
    assert train(tiny(expert_demos), folder).finished
    return folder


@pytest.mark.parametrize("stop", [3, 5])  # before and after relations are left out
def test_a_resumed_run_is_bit_equal(stop, whole, expert_demos, tmp_path):
    config = tiny(expert_demos)
    assert train(config, tmp_path / "run", stop_after=stop).step == stop
    assert train(config, tmp_path / "run", resume=True).finished
    assert_same(checkpoint(tmp_path / "run"), checkpoint(whole))


def test_metrics_and_policy(whole):
    newest = read_metrics(whole)[-1]
    assert {"loss", "accuracy", "target_loss", "destination_loss"} < newest.keys()
    assert not checkpoint(whole)["policy"]["goals.choice.used"].all()  # relations are left out
    assert evaluate(load_policy(whole), ["magical/FixColour-TestAll-v0"], rollouts=1, workers=0)


def test_mirrored_samples_have_mirrored_actions(expert_demos, tmp_path, monkeypatch):
    left, right = (Action(turn=turn).id for turn in (Turn.LEFT, Turn.RIGHT))
    mirrored = []
    labels = []

    def to_the_left(*arguments):
        data = ObjectData(*arguments)
        data.actions[:] = left
        return data

    def seen(*arguments):
        mirrored.append(arguments[-1])
        return control_inputs(*arguments)

    def learned(logits, actions):
        labels.append(actions)
        return cross_entropy(logits, actions)

    monkeypatch.setattr(object_bc, "ObjectData", to_the_left)
    monkeypatch.setattr(object_bc, "control_inputs", seen)
    monkeypatch.setattr(object_bc, "functional", SimpleNamespace(cross_entropy=learned))
    train(tiny(expert_demos, batches=1, batch_size=32), tmp_path / "run")
    assert torch.equal(labels[-1] == right, mirrored[-1])
    assert set(labels[-1].tolist()) == {left, right}


def _table():
    trajectory = demonstrate("magical/FixColour-Demo-v0", seed=3)
    return to_table(parse_frames(observations(trajectory, "LoRes4A", np.arange(4, 20, 3))[..., 9:]))


def test_mirrored_inputs_are_those_of_the_mirrored_scene():
    table = _table()
    count = table.size
    targets, destinations = torch.full((count,), 2), torch.rand((count, 2)) - 0.5
    sign = torch.tensor([-1.0, 1.0])
    turn = torch.tensor([-1.0, 1.0, -1.0])
    image = table._replace(
        robot=table.robot * turn,
        fingers=table.fingers.flip(1),
        blocks=torch.where(table.present[..., None], table.blocks * sign, table.blocks),
    )
    everywhere = torch.ones(count, dtype=torch.bool)
    mirrored = control_inputs(table, targets, destinations, everywhere)
    expected = control_inputs(image, targets, destinations * sign)
    torch.testing.assert_close(mirrored[0], expected[0], rtol=0, atol=1e-4)
    present = table.present
    torch.testing.assert_close(mirrored[1][present], expected[1][present], rtol=0, atol=1e-4)


def test_inputs_are_in_the_robots_frame():
    table = _table()
    targets, destinations = torch.full((table.size,), 2), torch.rand((table.size, 2)) - 0.5

    def turned(places):
        return torch.stack([-places[..., 1], places[..., 0]], dim=-1)

    angle = table.robot[:, 2:] + math.pi / 2
    other = table._replace(
        robot=torch.cat([turned(table.robot[:, :2]), angle], dim=1), blocks=turned(table.blocks)
    )
    found = control_inputs(other, targets, turned(destinations))
    expected = control_inputs(table, targets, destinations)
    torch.testing.assert_close(found[0], expected[0], rtol=0, atol=1e-4)
    present = table.present
    torch.testing.assert_close(found[1][present], expected[1][present], rtol=0, atol=1e-4)
