"""Object-centred behavioural cloning from beginning to end, in the smallest runs."""

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

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
from magical.scene.actions import Action, Turn
from magical.tasks import get_task, register_task, unregister_task
from magical_baselines import load_policy, train
from magical_goals import object_bc
from magical_goals.object_bc import ObjectBCConfig, make_policy
from magical_goals.objects.control import ROBOT_TARGET, ObjectTable, control_inputs, to_table
from magical_goals.objects.data import ObjectData
from magical_goals.objects.parser import parse_frames

TASKS = ("MoveToRegion", "FixColour")


@pytest.fixture(scope="module", autouse=True)
def small_updates_of_the_goal_model() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(object_bc, "GOAL_EVERY", 2)
        patch.setattr(object_bc, "GOAL_BATCH_SIZE", 4)
        yield


def tiny(demos: Path, **fields: Any) -> ObjectBCConfig:
    settings = {"tasks": TASKS, "demos": str(demos), "batches": 6, "batch_size": 8}
    return tiny_runs.tiny(ObjectBCConfig, "paper", **{**settings, **fields})


def test_tasks_with_more_objects_than_are_found_are_refused(tmp_path: Path) -> None:
    register_task(replace(get_task("MoveToRegion"), name="Many", max_blocks=11))
    try:
        with pytest.raises(
            InvalidConfigError, match=r"Many: expected at most 10 blocks .* found 11"
        ):
            tiny(tmp_path, tasks=("Many",))
    finally:
        unregister_task("Many")


@pytest.fixture(scope="module")
def whole(expert_demos: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that was never stopped."""
    folder = tmp_path_factory.mktemp("object-bc") / "run"
    assert train(tiny(expert_demos), folder).finished
    return folder


@pytest.mark.parametrize("stop", [3, 5])  # before and after relations are left out
def test_a_resumed_run_is_bit_equal(
    stop: int, whole: Path, expert_demos: Path, tmp_path: Path
) -> None:
    config = tiny(expert_demos)
    assert train(config, tmp_path / "run", stop_after=stop).step == stop
    assert train(config, tmp_path / "run", resume=True).finished
    assert_same(checkpoint(tmp_path / "run"), checkpoint(whole))


def test_relations_are_left_out_halfway(whole: Path) -> None:
    assert not checkpoint(whole)["policy"]["goals.choice.used"].all()


def test_learning_rates_are_annealed_to_0(whole: Path) -> None:
    rates = {}
    for name in ("optimizer", "goal_optimizer"):
        (group,) = checkpoint(whole)[name]["param_groups"]
        rates[name] = group["lr"]
    # Of batches 5 and 4, of six.
    assert rates == pytest.approx({"optimizer": 2e-3 / 6, "goal_optimizer": 0.05 / 3})


def test_metrics_and_policy(whole: Path) -> None:
    newest = read_metrics(whole)[-1]
    assert {"loss", "accuracy", "target_loss", "destination_loss"} < newest.keys()
    policy = load_policy(whole)
    scores = evaluate(policy, ["magical/FixColour-TestAll-v0"], rollouts=2, workers=0)
    assert len(scores) == 2


def test_a_robot_that_stands_still_acts_more_randomly(
    expert_demos: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stacks = torch.from_numpy(_stacks())
    stacks[0] = stacks[0, 9:].repeat(4, 1, 1)
    policy, found = make_policy(tiny(expert_demos)), []
    tasks = torch.ones(len(stacks), dtype=torch.int64)
    policy.goals.finished_bias.data.fill_(-100.0)  # a block is the target
    for cool, hot in ((1.0, 1.0), (0.5, 4.0)):
        monkeypatch.setattr(object_bc, "TEMPERATURE", cool)
        monkeypatch.setattr(object_bc, "STUCK_TEMPERATURE", hot)
        with torch.no_grad():
            found.append(policy(stacks, tasks))
    one, two = found
    torch.testing.assert_close(two[0], one[0] / 4.0)
    torch.testing.assert_close(two[1:], one[1:] * 2.0)


def test_a_robot_without_a_block_left_to_move_is_not_stuck(expert_demos: Path) -> None:
    policy = make_policy(tiny(expert_demos))
    table = _table()
    targets = torch.full((table.size,), ROBOT_TARGET)
    with torch.no_grad():
        stands, moved = (
            policy.control(table, table.robot + shift, targets, table.robot[:, :2])
            for shift in (0.0, 0.1)
        )
    torch.testing.assert_close(stands, moved)


def test_a_share_of_the_other_blocks_is_dropped_and_no_target(
    expert_demos: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    others = 0

    def counted(table: ObjectTable, targets: torch.Tensor, *rest: Any) -> Any:
        nonlocal others
        moved = targets != ROBOT_TARGET
        assert table.present[moved.nonzero()[:, 0], targets[moved]].all()
        others += int(table.present.sum() - moved.sum())
        return control_inputs(table, targets, *rest)

    found = []
    monkeypatch.setattr(object_bc, "control_inputs", counted)
    for share in (0.0, 0.25):
        others = 0
        monkeypatch.setattr(object_bc, "DROPPED", share)
        fields = {"tasks": ("FixColour",), "batch_size": 512}
        train(tiny(expert_demos, **fields), tmp_path / str(share))
        found.append(others)
    assert found[1] / found[0] == pytest.approx(0.75, abs=0.02)


def test_mirrored_samples_have_mirrored_actions(
    expert_demos: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    left, right = (Action(turn=turn).id for turn in (Turn.LEFT, Turn.RIGHT))
    mirrored: list[torch.Tensor] = []
    labels: list[torch.Tensor] = []

    def to_the_left(*arguments: Any) -> ObjectData:
        data = ObjectData(*arguments)
        data.actions[:] = left
        return data

    def seen(*arguments: Any) -> Any:
        mirrored.append(arguments[-1])
        return control_inputs(*arguments)

    def learned(logits: torch.Tensor, actions: torch.Tensor) -> torch.Tensor:
        labels.append(actions)
        return cross_entropy(logits, actions)

    monkeypatch.setattr(object_bc, "ObjectData", to_the_left)
    monkeypatch.setattr(object_bc, "control_inputs", seen)
    monkeypatch.setattr(object_bc, "functional", SimpleNamespace(cross_entropy=learned))
    train(tiny(expert_demos, batches=1, batch_size=32), tmp_path / "run")
    assert torch.equal(labels[-1] == right, mirrored[-1])
    assert set(labels[-1].tolist()) == {left, right}


def test_tables_have_columns_for_the_blocks_of_any_frame() -> None:
    parsed = parse_frames(_frames())
    table = to_table(parsed)
    assert table.present.sum() == (parsed.colours >= 0).sum() > 0
    assert 2 < table.present.shape[1] < parsed.colours.shape[1]
    nothing = parsed._replace(colours=np.full_like(parsed.colours, -1))
    assert to_table(nothing).present.shape[1] == 2


def _stacks() -> np.ndarray:
    trajectory = demonstrate("magical/FixColour-Demo-v0", seed=3)
    stacks = observations(trajectory, "LoRes4A", np.arange(4, 20, 3))
    return np.ascontiguousarray(stacks.transpose(0, 3, 1, 2))


def _frames() -> np.ndarray:
    return np.ascontiguousarray(_stacks().transpose(0, 2, 3, 1)[..., 9:])


def _table() -> ObjectTable:
    return to_table(parse_frames(_frames()))


def test_mirrored_inputs_are_those_of_the_mirrored_scene() -> None:
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


def test_inputs_are_in_the_robots_frame() -> None:
    table = _table()
    targets, destinations = torch.full((table.size,), 2), torch.rand((table.size, 2)) - 0.5

    def turned(places: torch.Tensor) -> torch.Tensor:
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


def test_a_wall_is_seen_from_near() -> None:
    table, targets = _table().select(slice(0, 1)), torch.tensor([ROBOT_TARGET])
    table = table._replace(robot=torch.tensor([[0.9, 0.1, 0.0]]))
    near, _, _ = control_inputs(table, targets, torch.tensor([[0.9, -0.8]]))
    # Of the robot, and twice of its destination; 0.05 is added to distances.
    right = [0.1 / 0.15 * 0.75, 0.0, 0.75]
    behind = [0.0, -0.2 / 0.25 * 0.5, 0.5]
    expected = [*right, 0.0, 0.0, 0.0, *right, *behind, *right, *behind]
    torch.testing.assert_close(near[0, -18:], torch.tensor(expected))
