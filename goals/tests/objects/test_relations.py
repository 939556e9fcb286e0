"""Relations: their values in a small scene, and what they do not depend on."""

import pytest
import torch

from magical_goals.objects.control import ROBOT_TARGET, ObjectTable
from magical_goals.objects.goals import (
    RELATIONS,
    UNKNOWN,
    GoalModel,
    PiecewiseLinear,
    relate,
    relate_blocks,
)
from magical_goals.objects.parser import FAR

NAMES = [relation.name for relation in RELATIONS]


def make_table(seed=0, count=5):
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


def value(relations, name):
    return float(relations[..., NAMES.index(name)])


def test_values_in_a_scene_made_by_hand():
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
def test_relations_do_not_depend_on(change):
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


def test_decisions_do_not_depend_on_the_order_of_blocks():
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


def one_scene(count=2):
    """A scene of blocks far from one another and from the gripper."""
    table = make_table(count=count).select(slice(0, 1))
    blocks = table.blocks.clone()
    blocks[0, :count] = torch.tensor([[-0.6, -0.6], [0.6, 0.6], [-0.6, 0.6]])[:count]
    return table._replace(blocks=blocks, robot=torch.zeros(1, 3))


def test_relations_that_explain_nothing_are_left_out():
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
