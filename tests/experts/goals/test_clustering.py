"""The Cluster tasks' goals: plans that solve, and how enclosed blocks are priced."""

from operator import attrgetter

import numpy as np
import pytest

from magical.experts import MovePlan, Strategy, get_planner
from magical.experts.goals._clustering import ClusterLayout, Pricing
from magical.scene import Block, Pose, Poses, Scene
from magical.scene.geometry import Point
from magical.tasks import get_task
from tests.experts.scenes import blocks_at, view_of

STRATEGY = Strategy.sample(np.random.default_rng(0))


def moved(scene: Scene, places: list[Point]) -> Scene:
    blocks = [
        Block(block.shape, block.colour, Pose(x, y, 0.0))
        for block, (x, y) in zip(scene.blocks, places, strict=True)
    ]
    return Scene(scene.robot, tuple(blocks), scene.regions)


@pytest.mark.parametrize("task", ["ClusterColour", "ClusterShape"])
def test_plans_solve_the_task_and_leave_a_solved_one(task: str) -> None:
    spec, planner = get_task(task), get_planner(task)
    scene, plan = spec.demo, MovePlan()
    places = list(view_of(scene).blocks)
    for _ in range(20):  # make the first move of each plan
        plan = planner.plan_fn(view_of(moved(scene, places)), STRATEGY, plan)
        if not plan.moves:
            break
        move = plan.moves[0]
        assert move.block is not None
        places[move.block] = move.goal
    assert not plan.moves
    done = moved(scene, places)
    assert planner.solved_fn(view_of(done))
    assert spec.score(done, Poses.at_rest(done)) == 1.0


def test_enclosed_blocks_are_hard_to_grasp_until_the_others_are_gone() -> None:
    scene = blocks_at((-0.82, 0.0), (-0.62, -0.14), (-0.62, 0.14), (-0.82, 0.28), (0.4, 0.0))
    pricing = Pricing(ClusterLayout.from_view(view_of(scene), attrgetter("colour")))
    itself = np.eye(5, dtype=np.bool_)
    enclosed, free = pricing.grasp_costs_among(~itself), pricing.grasp_costs_among(itself)
    assert enclosed[0] > 10.0  # measured: of those, more than four in five are never grasped
    assert enclosed[4] == 0.0
    assert free.max() < 8.0 + 1e-9  # one finger between block and wall at most
    assert np.array_equal(pricing.grasp_costs, enclosed)


@pytest.mark.parametrize("sign", [1, -1])
def test_blocks_are_ranked_by_access_and_ties_by_order(sign: int) -> None:
    """The first two are mirrored: their costs differ by rounding only, whichever comes first."""
    places = (
        (-0.85, 0.13),
        (-0.85, -0.13),
        (-0.6, 0.14),
        (-0.6, -0.14),
        (-0.85, 0.4),
        (-0.85, -0.4),
    )
    scene = blocks_at(*((x, sign * y) for x, y in places))
    pricing = Pricing(ClusterLayout.from_view(view_of(scene), attrgetter("colour")))
    assert pricing.grasp_costs[0] == pytest.approx(pricing.grasp_costs[1])
    assert pricing.grasp_costs[0] > 10.0
    assert pricing.rank.tolist() == [4, 5, 0, 1, 2, 3]
