"""Relations: their values in a small scene, and what they do not depend on."""

import math

import numpy as np
import pytest
import torch

from magical_goals.objects import goals
from magical_goals.objects.control import ROBOT_TARGET, ObjectTable
from magical_goals.objects.goals import (
    RELATIONS,
    UNKNOWN,
    GoalModel,
    PiecewiseLinear,
    goal_losses,
    relate,
    relate_blocks,
)
from magical_goals.objects.parser import FAR

NAMES = [relation.name for relation in RELATIONS]


def make_table(seed: int = 0, count: int = 5) -> ObjectTable:
    """Three random scenes of `count` blocks and two regions."""
    generator = torch.Generator().manual_seed(seed)
    blocks = torch.full((3, 10, 2), FAR)
    blocks[:, :count] = torch.rand((3, count, 2), generator=generator) * 1.8 - 0.9
    kinds = torch.full((2, 3, 10), -1)
    kinds[:, :, :count] = torch.randint(0, 4, (2, 3, count), generator=generator)
    regions = torch.tensor([[-0.5, 0.5, 0.3, 0.3], [0.5, -0.4, 0.3, 0.2], [0.0, 0.0, 0.0, 0.0]])
    robot = torch.rand((3, 3), generator=generator)
    return ObjectTable(
        robot, torch.zeros(3, 2), blocks, kinds[0], kinds[1],
        regions.expand(3, 3, 4), torch.tensor([[0, 1, -1]]).expand(3, 3),
    )  # fmt: skip


def value(relations: torch.Tensor, name: str) -> float:
    return float(relations[..., NAMES.index(name)])


def test_values_in_a_scene_made_by_hand() -> None:
    table = make_table(count=3).select(slice(0, 1))
    blocks = table.blocks.clone()
    blocks[0, :3] = torch.tensor([[0.0, 0.0], [0.3, 0.4], [-0.5, 0.4]])
    table = table._replace(
        blocks=blocks,
        colours=torch.tensor([[0, 0, 1, *[-1] * 7]]),
        shapes=torch.tensor([[2, 3, 2, *[-1] * 7]]),
    )
    found = relate(table, torch.tensor([0]), table.blocks[:, :1])[0, 0]
    assert value(found, "region of the same colour") == pytest.approx(0.2)
    assert value(found, "block of the same colour alone, in none") == pytest.approx(0.5)
    assert value(found, "block of the same colour alone, in a region") == UNKNOWN
    assert value(found, "block of the same shape alone, in a region") == pytest.approx(0.41**0.5)
    assert value(found, "block of the same colour and shape, in none") == UNKNOWN
    assert value(found, "wall") == pytest.approx(1.0)
    assert value(found, "share of the own colour's distance") == pytest.approx(
        0.5 / (0.5 + 0.41**0.5), abs=1e-4
    )
    assert value(found, "share of the own shape's distance") == pytest.approx(
        0.41**0.5 / (0.5 + 0.41**0.5), abs=1e-4
    )
    # The line of the other two is 0.4 away; along it, the nearer one is at a neighbour's distance.
    assert value(found, "line of two other blocks") == pytest.approx(0.4)
    assert value(found, "line of two other blocks side by side") == UNKNOWN
    nearer, farther = relate(table, torch.tensor([0]), torch.tensor([[[0.2, 0.4], [0.9, 0.4]]]))[0]
    assert value(nearer, "line of two other blocks") == pytest.approx(2 * 0.1)
    assert value(farther, "line of two other blocks") == pytest.approx(0.2)
    assert value(found, "x, where there is nothing else") == UNKNOWN
    robot = relate(table, torch.tensor([ROBOT_TARGET]), table.blocks[:, :1])[0, 0]
    assert value(robot, "region of the same colour") == UNKNOWN
    assert value(robot, "any region") == pytest.approx(0.2)


@pytest.mark.parametrize("change", ["colours", "shapes", "mirrored", "turned"])
def test_relations_do_not_depend_on(change: str) -> None:
    table = make_table()
    permutation = torch.tensor([2, 0, 3, 1, -1])  # the last stands for absent ones
    if change == "colours":
        other = table._replace(
            colours=permutation[table.colours], region_colours=permutation[table.region_colours]
        )
    elif change == "shapes":
        other = table._replace(shapes=permutation[table.shapes])
    elif change == "mirrored":
        sign = torch.tensor([-1.0, 1.0])
        other = table._replace(
            blocks=torch.where(table.present[..., None], table.blocks * sign, table.blocks),
            regions=table.regions * torch.tensor([-1.0, 1.0, 1.0, 1.0]),
        )
    else:
        turned = torch.where(
            table.present[..., None],
            torch.stack([-table.blocks[..., 1], table.blocks[..., 0]], dim=2),
            table.blocks,
        )
        x, y, width, height = table.regions.unbind(dim=2)
        other = table._replace(blocks=turned, regions=torch.stack([-y, x, height, width], dim=2))
    expected, found = relate_blocks(table)[:, :5], relate_blocks(other)[:, :5]
    torch.testing.assert_close(found, expected, rtol=0, atol=1e-5)


def test_decisions_do_not_depend_on_the_order_of_blocks() -> None:
    table = make_table()
    model = GoalModel(1)
    generator = torch.Generator().manual_seed(1)
    with torch.no_grad():
        for values in model.parameters():
            values.copy_(torch.randn(values.shape, generator=generator))
        model.finished_bias.fill_(-100.0)
    tasks = torch.zeros(3, dtype=torch.int64)
    order = torch.tensor([3, 1, 4, 0, 2, 5, 6, 7, 8, 9])
    shuffled = table._replace(
        blocks=table.blocks[:, order],
        colours=table.colours[:, order],
        shapes=table.shapes[:, order],
    )
    targets, places = model.decide(table, tasks)
    other_targets, other_places = model.decide(shuffled, tasks)
    assert order[other_targets].tolist() == targets.tolist()
    torch.testing.assert_close(other_places, places)


def one_scene(count: int = 2) -> ObjectTable:
    """A scene of blocks far from one another and from the gripper."""
    table = make_table(count=count).select(slice(0, 1))
    blocks = table.blocks.clone()
    blocks[0, :count] = torch.tensor([[-0.6, -0.6], [0.6, 0.6], [-0.6, 0.6]])[:count]
    return table._replace(blocks=blocks, robot=torch.zeros(1, 3))


@pytest.mark.parametrize("count", [2, 3])
def test_blocks_at_their_destinations_give_way_unless_they_are_gripped(
    count: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    table, model, tasks = one_scene(count), GoalModel(1), torch.zeros(1, dtype=torch.int64)
    with torch.no_grad():
        model.finished_bias.fill_(-100.0)
    nearest = int((table.blocks[0, :count] - table.grip).norm(dim=1).argmin())
    assert model.decide(table, tasks)[0].tolist() == [nearest]
    monkeypatch.setattr(goals, "NEARNESS", 400.0)  # every block's best place is its own
    assert model.decide(table, tasks)[0].tolist() == [ROBOT_TARGET]
    gripped = table._replace(blocks=table.blocks.clone())
    gripped.blocks[0, nearest] = table.grip[0]
    assert model.decide(gripped, tasks)[0].tolist() == [nearest]


@pytest.mark.parametrize(("probability", "stops"), [(0.75, False), (0.85, True)])
def test_it_stops_only_where_it_is_sure(probability: float, stops: bool) -> None:
    table, model, tasks = one_scene(), GoalModel(1), torch.zeros(1, dtype=torch.int64)
    blocks = model.target_logits(table, relate_blocks(table), tasks)[:, :-1]
    odds = math.log(probability / (1 - probability))
    with torch.no_grad():
        model.finished_bias.fill_(blocks.logsumexp(dim=1).item() + odds)
    assert (model.decide(table, tasks)[0].item() == ROBOT_TARGET) is stops


def test_nothing_is_left_to_do_where_no_block_has_a_high_score() -> None:
    table, model, tasks = one_scene(), GoalModel(1), torch.zeros(1, dtype=torch.int64)
    with torch.no_grad():
        model.finished_bias.fill_(0.5)
        model.finished_slope.fill_(2.0)
        model.choice.values[:, NAMES.index("any region")] = 3.0
    logits = model.target_logits(table, relate_blocks(table), tasks)
    assert logits[0, -1].item() == pytest.approx(0.5 - 2.0 * 3.0)
    empty = table._replace(colours=torch.full_like(table.colours, -1))
    logits = model.target_logits(empty, relate_blocks(empty), tasks)
    assert logits[0, -1].item() == pytest.approx(0.5 + 2.0 * goals.LARGE)


@pytest.mark.parametrize("height", [0.0, 5.0])
def test_a_broad_place_is_better_than_a_narrow_one(
    height: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    plateau, peak = torch.tensor([-0.4, -0.4]), torch.tensor([0.653, 0.653])

    def logits(model: GoalModel, *arguments: torch.Tensor) -> torch.Tensor:
        places = arguments[2]
        narrow: torch.Tensor = 5.5 * ((places - peak).norm(dim=-1) < 0.06)
        broad: torch.Tensor = height * ((places - plateau).abs().amax(-1) < 0.2)
        return narrow + broad

    monkeypatch.setattr(GoalModel, "destination_logits", logits)
    model, tasks = GoalModel(1), torch.zeros(1, dtype=torch.int64)
    (place,) = model.decide(one_scene(), tasks)[1]
    expected = plateau if height else peak
    assert (place - expected).norm().item() < (0.2 if height else 0.05)


def test_decisions_do_not_need_the_relations_that_were_left_out() -> None:
    table, model, tasks = make_table(), GoalModel(2), torch.tensor([0, 1, 0])
    with torch.no_grad():
        model.finished_bias.fill_(-100.0)
        for part in (model.choice, model.destination):
            part.values.normal_(generator=torch.Generator().manual_seed(0))
            part.used.bernoulli_(0.2, generator=torch.Generator().manual_seed(1))
            assert 0 < len(part.wanted(tasks)) < len(NAMES)
    found = model.decide(table, tasks)
    with torch.no_grad():
        for part in (model.choice, model.destination):
            part.values.mul_(part.used)
            part.used.fill_(1.0)
            assert len(part.wanted(tasks)) == len(NAMES)
    expected = model.decide(table, tasks)
    assert found[0].tolist() == expected[0].tolist()
    torch.testing.assert_close(found[1], expected[1])


@pytest.mark.parametrize("target", [0, ROBOT_TARGET])
def test_tasks_and_the_robot_have_destinations_of_their_own(target: int) -> None:
    table, model, tasks = one_scene(), GoalModel(2), torch.ones(1, dtype=torch.int64)
    targets, places = torch.tensor([target]), torch.tensor([[[0.1, 0.2], [0.5, -0.4]]])
    own = 3 if target == ROBOT_TARGET else 2  # the second task's

    def logits() -> torch.Tensor:
        return model.destination_logits(table, targets, places, tasks)

    plain = logits()
    with torch.no_grad():
        model.destination.values[np.arange(4) != own] = 3.0
        assert torch.equal(logits(), plain)
        model.destination.values[own] = 3.0
        assert (logits() > plain).all()


def test_losses_are_negative_log_likelihoods_of_targets_and_destinations() -> None:
    """Of a model without functions of relations, for which nearness decides alone."""
    table, model, tasks = one_scene(), GoalModel(1), torch.zeros(1, dtype=torch.int64)
    distances = (table.blocks[0, :2] - table.grip).norm(dim=1)
    places = table.blocks[:, :2] + 0.3  # of both blocks

    def losses(target: int, destination: int) -> list[float]:
        chosen = torch.tensor([target]), places[:, destination]
        others = places[:, 1 - destination, None]
        relations = relate_blocks(table)
        found = goal_losses(model, table, relations, *chosen, tasks, others)
        return [loss.item() for loss in found]

    logits = torch.cat([-goals.NEARNESS * distances, torch.zeros(1)])  # last: nothing is left
    expected = -logits.log_softmax(dim=0)
    assert [losses(k, 0)[0] for k in (0, 1, ROBOT_TARGET)] == pytest.approx(expected.tolist())
    ways = (places[0] - table.blocks[0, 0]).norm(dim=1)  # of block 0
    expected = -(-goals.NEARNESS * ways).log_softmax(dim=0)
    assert [losses(0, k)[1] for k in (0, 1)] == pytest.approx(expected.tolist())


def test_relations_that_explain_nothing_are_left_out() -> None:
    torch.manual_seed(0)
    functions = PiecewiseLinear([(0.0, 0.5, 1.0)] * 3, [1.0] * 3, sets=1)
    optimizer = torch.optim.Adam(functions.parameters(), 0.05)
    numbers = torch.rand(500, 3)
    sets = torch.zeros(500, dtype=torch.int64)
    for _ in range(300):
        loss = ((functions(numbers, sets) - 2.0 * numbers[:, 1]) ** 2).mean()
        optimizer.zero_grad()
        torch.autograd.backward(loss + functions.penalty(sparsity=0.05))
        optimizer.step()
    functions.leave_out()
    assert functions.used[0, :, 0].tolist() == [0.0, 1.0, 0.0]
    changed = numbers.clone()
    changed[:, 0] = UNKNOWN
    torch.testing.assert_close(functions(changed, sets), functions(numbers, sets))
