"""Planners: plans that solve their task and then end, and planners from outside the package."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations
from operator import attrgetter

import numpy as np
import pytest

from magical.errors import NoExpertError
from magical.experts import (
    Move,
    MovePlan,
    Planner,
    StateView,
    Strategy,
    expert_for,
    get_planner,
    has_expert,
    register_planner,
    rollout,
)
from magical.experts.goals import _planners
from magical.experts.goals.clustering import Layout
from magical.experts.goals.make_line import is_line
from magical.physics import Simulation
from magical.scene import POINTS, Point, Pose, Poses, Scene
from magical.tasks import get_task, register_task, unregister_task
from tests.experts.scenes import blocks_at, state_of, view_of

LINE = get_planner("MakeLine")
STRATEGY = Strategy.sample(np.random.default_rng(0))


def moved(scene: Scene, places: Sequence[Point]) -> Scene:
    blocks = [
        replace(block, pose=Pose(x, y, 0.0))
        for block, (x, y) in zip(scene.blocks, places, strict=True)
    ]
    return replace(scene, blocks=tuple(blocks))


@pytest.mark.parametrize("task", ["MakeLine", "ClusterColour", "ClusterShape"])
def test_plans_solve_the_task_and_leave_a_solved_one(task: str) -> None:
    spec, planner = get_task(task), get_planner(task)
    scene, plan = spec.demo, MovePlan()
    places = list(view_of(scene).blocks)
    for _ in range(20):  # make the first move of each plan
        plan = planner.plan_fn(view_of(moved(scene, places)), STRATEGY, plan)
        if not plan.moves:
            break
        places[plan.moves[0].block] = plan.moves[0].goal
    assert not plan.moves
    done = moved(scene, places)
    assert planner.solved_fn(view_of(done))
    assert spec.score(done, Poses.at_rest(done)) == 1.0


def test_line_with_a_margin_scores_fully() -> None:
    rng, made = np.random.default_rng(0), 0
    for _ in range(300):
        along = np.cumsum(rng.uniform(0.2, 0.45, size=4)) - 0.9
        places = [(float(x), float(y)) for x, y in zip(along, rng.normal(0, 0.1, 4), strict=True)]
        if is_line(places):
            made += 1
            scene = blocks_at(*places)
            assert get_task("MakeLine").score(scene, Poses.at_rest(scene)) == 1.0
    assert made > 20


def test_a_line_with_one_gap_too_wide_asks_for_one_short_move() -> None:
    scene = blocks_at((0.0, -0.6), (0.0, -0.19), (0.0, 0.22), (0.0, 0.65))
    moves = LINE.plan_fn(view_of(scene), STRATEGY, MovePlan()).moves
    assert [move.block for move in moves] == [3]
    distance = math.dist(moves[0].goal, (0.0, 0.65))
    assert distance < 0.3
    assert moves[0].tolerance <= 0.5 * distance


def test_places_in_a_line_leave_room_between_blocks() -> None:
    rng = np.random.default_rng(1)
    for _ in range(15):
        scene = blocks_at(*((float(x), float(y)) for x, y in rng.uniform(-0.8, 0.8, size=(4, 2))))
        plan = LINE.plan_fn(view_of(scene), STRATEGY, MovePlan())
        moving = {move.block for move in plan.moves}
        for pair in combinations(range(len(plan.places)), 2):
            if moving & {*pair}:
                assert math.dist(*(plan.places[i] for i in pair)) > 0.25


@pytest.mark.parametrize("sign", [1, -1])
def test_enclosed_blocks_are_ranked_last_and_ties_by_order(sign: int) -> None:
    """The first two are mirrored: their costs differ by rounding only, whichever comes first."""
    places = (-0.85, 0.13), (-0.85, -0.13), (-0.6, 0.14), (-0.6, -0.14), (-0.85, 0.4), (-0.85, -0.4)
    scene = blocks_at(*((x, sign * y) for x, y in places))
    layout = Layout(view_of(scene), attrgetter("colour"))
    assert layout.grasp_costs[0] == pytest.approx(layout.grasp_costs[1])
    assert layout.grasp_costs[0] > 10.0  # of those, more than four in five are never grasped
    assert layout.rank.tolist() == [4, 5, 0, 1, 2, 3]
    free = layout.grasp_costs_among(np.eye(len(places), dtype=np.bool_))
    assert free.max() < 8.0 + 1e-9  # alone: one finger between block and wall at most


@pytest.mark.parametrize(
    ("variant", "seed"),
    [("TestAll", 5027), ("TestAll", 5125), ("TestAll", 5157), ("TestLayout", 5320)],
)
def test_the_robot_stays_in_a_region_at_a_wall(variant: str, seed: int) -> None:
    """In the depth of these regions the open fingers would meet the wall."""
    episode = rollout("MoveToRegion", variant, seed)
    region = episode.scene.regions[0]
    inside = [region.contains(x, y) for x, y, _ in episode.poses[:, 0].tolist()]
    assert inside == sorted(inside)
    assert episode.score == 1.0


@pytest.fixture
def drive_there() -> Iterator[str]:
    """A task from outside the package, without an expert."""
    region = get_task("MoveToRegion")
    task = register_task(replace(region, name="DriveThere", section=""))
    yield task.name
    unregister_task(task.name)
    _planners.pop(task.name, None)


def test_a_task_from_outside_gets_its_expert(drive_there: str) -> None:
    assert not has_expert(drive_there)
    message = (
        r"expected one of: MoveToCorner, .*; add an entry point DriveThere .* or call "
        r"magical.experts.register_planner\('DriveThere'"
    )
    with pytest.raises(NoExpertError, match=message):
        get_planner(drive_there)

    def plan(view: StateView, strategy: Strategy, last: MovePlan) -> MovePlan:
        there = (0.5, 0.5)
        return MovePlan((Move(there, 0.1),) if view.distance_to(there) > 0.1 else ())

    register_planner(drive_there, Planner(plan))
    scene = get_task("MoveToRegion").demo
    simulation, expert, memory = Simulation(scene), expert_for(drive_there, seed=0), None
    for _ in range(40):
        action, memory = expert.act(state_of(simulation, scene), memory)
        simulation.step(POINTS[action])
    assert np.hypot(*(simulation.poses().bodies[0, :2] - 0.5)) < 0.2
