"""Grasps: the vectorised costs against the slow reference, and the sides that they choose."""

import math

import numpy as np
import pytest

from magical.experts.geometry import bearing
from magical.experts.grasp import (
    SIDE_SWITCH_STEPS,
    SIDES,
    best_side,
    gate_point,
    grasp_costs,
    make_mutual_grasps,
)
from magical.experts.state_view import StateView
from magical.scene import Pose
from tests.experts import grasp_reference as reference
from tests.experts.scenes import blocks_at, view_of

NO_PREFERENCES = [0.0] * len(SIDES)


def crowded(rng: np.random.Generator, blocks: int) -> StateView:
    """Blocks anywhere, often in each other's way and at walls."""
    places = [(x, y) for x, y in rng.uniform(-0.95, 0.95, size=(blocks, 2)).tolist()]
    return view_of(blocks_at(*places, robot=Pose(*rng.uniform((-0.8, -0.8, -4), (0.8, 0.8, 4)))))


@pytest.mark.parametrize("blocks", [1, 2, 10])
def test_obstruction_of_all_blocks_agrees_with_the_reference(blocks: int) -> None:
    rng = np.random.default_rng(blocks)
    for _ in range(5):
        places = crowded(rng, blocks).blocks
        found = make_mutual_grasps(np.array(places))
        walls = [[reference.wall_cost(block, side) for side in SIDES] for block in places]
        others = [
            [
                [0.0 if b is a else reference.block_cost(a, side, b) for b in places]
                for side in SIDES
            ]
            for a in places
        ]
        np.testing.assert_allclose(found.wall_costs, walls, rtol=0, atol=1e-9)
        np.testing.assert_allclose(found.block_costs, others, rtol=0, atol=1e-9)
        assert blocks < 10 or found.block_costs.max() > 0.0


@pytest.mark.parametrize("blocks", [1, 2, 10])
def test_grasp_costs_agree_with_the_reference(blocks: int) -> None:
    rng = np.random.default_rng(blocks)
    for _ in range(20):
        view = crowded(rng, blocks)
        block, others, goal = view.blocks[0], view.other_blocks(0), (0.3, -0.4)
        sides = np.append(SIDES, bearing(view.position, block))
        costs = grasp_costs(view, block, goal, others, sides)
        slow = [reference.grasp_cost(view, block, goal, others, side) for side in sides]
        np.testing.assert_allclose(costs, slow, rtol=0, atol=1e-9)


def test_best_side_is_the_cheapest_with_preferences() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        view, preferences = crowded(rng, 5), rng.uniform(0, 4, size=len(SIDES)).tolist()
        direct = bearing(view.position, view.blocks[0])
        priced = {
            side: reference.grasp_cost(view, view.blocks[0], (0, 0), view.blocks[1:], side) + extra
            for side, extra in zip([direct, *SIDES], [preferences[0], *preferences], strict=True)
        }
        side, cost = best_side(view, view.blocks[0], (0, 0), view.blocks[1:], preferences)
        assert cost == pytest.approx(min(priced.values()))
        assert priced[side] == pytest.approx(cost)


def test_a_side_is_left_only_for_a_clearly_better_one() -> None:
    view = view_of(blocks_at((0.0, 0.0)))
    block, goal = view.blocks[0], (-0.6, -0.3)
    best, least = best_side(view, block, goal, (), NO_PREFERENCES)
    costs = grasp_costs(view, block, goal, (), SIDES)
    near = SIDES[(costs > least) & (costs < least + SIDE_SWITCH_STEPS)]
    far = SIDES[costs > least + SIDE_SWITCH_STEPS]
    assert len(near)
    assert len(far)
    for side in near:
        kept, cost = best_side(view, block, goal, (), NO_PREFERENCES, current=side)
        assert kept == side
        assert cost > least
    for side in far:
        assert best_side(view, block, goal, (), NO_PREFERENCES, current=side)[0] == best


def test_block_at_a_wall_is_grasped_from_inside() -> None:
    view = view_of(blocks_at((-0.88, 0.0)))
    side, _ = best_side(view, (-0.88, 0.0), (0.5, 0.0), [], NO_PREFERENCES)
    assert math.sin(side) > 0.3  # facing left
    assert max(map(abs, gate_point((0.0, -0.3), 0.0))) < 0.8
