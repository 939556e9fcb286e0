"""What experts plan with: ways around obstacles, the motion model, lines, clusters."""

import math
from itertools import combinations

import numpy as np
import pytest

from magical.experts.carry import carry
from magical.experts.goals import NO_PLAN, Style, goals_of
from magical.experts.grasp import SIDES, best_side, gate_to, in_jaw
from magical.experts.jumble import Jumble
from magical.experts.lines import is_line
from magical.experts.motions import HOLD, table_for
from magical.experts.paths import gap, is_clear, next_waypoint
from magical.experts.sight import Sight, bearing, wrap
from magical.physics import Simulation
from magical.scene import Block, Pose, Poses, Scene, State
from magical.scene.geometry import Point
from magical.tasks import get_task


def sight_of(scene: Scene, world: Simulation | None = None) -> Sight:
    table = (world or Simulation(scene)).read()
    return Sight.of(State(scene, Poses(table[:, :3]), table[:, 3:], 0, 100))


def blocks_at(*places: Point) -> Scene:
    blocks = [Block("circle", "red", Pose(x, y, 0)) for x, y in places]  # type: ignore[arg-type]
    return Scene(Pose(0.8, 0.8, 0.0), tuple(blocks))


STYLE = Style.draw(np.random.default_rng(0), SIDES)


def test_bearing_is_the_angle_that_faces_a_point() -> None:
    sight = sight_of(Scene(Pose(0.1, -0.2, bearing((0.1, -0.2), (0.6, 0.4)))))
    x, y = sight.local((0.6, 0.4))
    assert x == pytest.approx(0.0, abs=1e-12)
    assert y == pytest.approx(math.hypot(0.5, 0.6))
    assert wrap(3 * math.pi / 2) == pytest.approx(-math.pi / 2)


def test_clear_way_is_straight() -> None:
    assert next_waypoint((-0.5, 0.0), (0.5, 0.0), [(0.0, 0.6)], 0.34, 0.0) == (0.5, 0.0)


def test_way_leads_around_an_obstacle() -> None:
    at, goal, wall = (-0.6, 0.0), (0.6, 0.0), [(0.0, y) for y in (0.0, 0.2, 0.4)]
    least, length = math.inf, 0.0
    for _ in range(60):
        point = next_waypoint(at, goal, wall, 0.3, 0.0)
        step = min(0.05, math.dist(at, point))
        angle = math.atan2(point[1] - at[1], point[0] - at[0])
        at = (at[0] + step * math.cos(angle), at[1] + step * math.sin(angle))
        least = min(least, *(math.dist(at, obstacle) for obstacle in wall))
        length += step
    assert math.dist(at, goal) < 0.06
    assert least > 0.22
    assert length < 2.2


def test_clear_counts_only_what_comes_closer() -> None:
    assert is_clear((0.0, 0.0), (1.0, 0.0), [(-0.1, 0.0)], 0.3)
    assert not is_clear((0.0, 0.0), (1.0, 0.0), [(0.2, 0.1)], 0.3)
    assert gap((0.0, 0.0), (0.0, 0.0), (3.0, 4.0)) == 5.0


@pytest.mark.parametrize("shape", ["square", "circle", "pentagon", "star"])
def test_motion_model_agrees_with_the_physics(shape: str) -> None:
    """Where a held block is after five steps of one action: within a good half of its size."""
    table = table_for(0.0, 0.0)
    for action in (1, 2, 3, 4, 8):
        block = Block(shape, "red", Pose(0.0, HOLD, 0.0))  # type: ignore[arg-type]
        world = Simulation(Scene(Pose(0.0, 0.0, 0.0), (block,)))
        for order in [9] * 3 + [action + 9] * 5 + [9]:
            world.step(order)
        # Of the pairs that begin so and last five steps, the last keeps the action up throughout.
        row = np.flatnonzero((table.first == action) & (table.time == 5))[-1]
        predicted = table.block[row, -1]
        assert math.dist(world.poses().blocks[0, :2], predicted) < 0.14, action


def test_held_block_is_carried_there() -> None:
    scene = blocks_at((0.0, 0.335), (0.1, 0.75))
    scene = Scene(Pose(0.0, 0.0, 0.0), scene.blocks)
    world, goal = Simulation(scene), (-0.5, 0.1)
    for _ in range(3):
        world.step(9)
    for _ in range(25):
        sight = sight_of(scene, world)
        assert in_jaw(sight, sight.blocks[0], held=1)
        if math.dist(sight.resting[0], goal) < 0.08:
            break
        world.step(carry(sight, sight.blocks[0], goal, 0.08, sight.blocks[1:]))
    assert math.dist(world.poses().blocks[0, :2], goal) < 0.12
    assert np.allclose(world.poses().blocks[1, :2], (0.1, 0.75))


def test_block_at_a_wall_is_grasped_from_inside() -> None:
    sight = sight_of(blocks_at((-0.88, 0.0)))
    side, _ = best_side(sight, (-0.88, 0.0), (0.5, 0.0), [], [0.0] * SIDES)
    assert math.sin(side) > 0.3  # facing left
    assert max(map(abs, gate_to((0.0, -0.3), 0.0))) < 0.8


def test_line_with_something_to_spare_scores_fully() -> None:
    rng, task, made = np.random.default_rng(0), get_task("MakeLine"), 0
    for _ in range(300):
        along = np.cumsum(rng.uniform(0.2, 0.45, size=4))
        places = [
            (float(x) - 0.9, float(y)) for x, y in zip(along, rng.normal(0, 0.1, 4), strict=True)
        ]
        scene = blocks_at(*places)
        if is_line(places):
            made += 1
            assert task.score(scene, Poses.at_rest(scene)) == 1.0
    assert made > 20


def test_plan_of_a_line_solves_it_and_then_ends() -> None:
    scene = get_task("MakeLine").demo
    plan = goals_of("MakeLine").plan(sight_of(scene), STYLE, NO_PLAN)
    places = list(sight_of(scene).blocks)
    for move in plan.moves:
        assert move.block is not None
        places[move.block] = move.goal
    made = blocks_at(*places)
    assert get_task("MakeLine").score(made, Poses.at_rest(made)) == 1.0
    assert goals_of("MakeLine").plan(sight_of(made), STYLE, NO_PLAN).moves == ()
    assert goals_of("MakeLine").solved(sight_of(made))


def test_a_line_with_one_gap_too_wide_asks_for_one_short_move() -> None:
    scene = blocks_at((0.0, -0.6), (0.0, -0.19), (0.0, 0.22), (0.0, 0.65))
    moves = goals_of("MakeLine").plan(sight_of(scene), STYLE, NO_PLAN).moves
    assert [move.block for move in moves] == [3]
    way = math.dist(moves[0].goal, (0.0, 0.65))
    assert way < 0.3
    assert moves[0].tolerance <= 0.5 * way


def test_places_of_a_line_leave_room_between_blocks() -> None:
    rng = np.random.default_rng(1)
    for _ in range(30):
        scene = blocks_at(*((float(x), float(y)) for x, y in rng.uniform(-0.8, 0.8, size=(4, 2))))
        plan = goals_of("MakeLine").plan(sight_of(scene), STYLE, NO_PLAN)
        moved = [move.block for move in plan.moves]
        for i, j in combinations(range(len(plan.places)), 2):
            if i in moved or j in moved:
                assert math.dist(plan.places[i], plan.places[j]) > 0.25


@pytest.mark.parametrize("task", ["ClusterColour", "ClusterShape"])
def test_plan_of_clusters_solves_them_and_leaves_solved_ones(task: str) -> None:
    spec, goals = get_task(task), goals_of(task)
    scene = spec.demo
    places, plan = list(sight_of(scene).blocks), NO_PLAN
    for _ in range(20):  # make the first move of each plan
        now = _moved(scene, places)
        plan = goals.plan(sight_of(now), STYLE, plan)
        if not plan.moves:
            break
        move = plan.moves[0]
        assert move.block is not None
        places[move.block] = move.goal
    assert not plan.moves
    done = _moved(scene, places)
    assert goals.solved(sight_of(done))
    assert spec.score(done, Poses.at_rest(done)) == 1.0


def _moved(scene: Scene, places: list[Point]) -> Scene:
    blocks = [
        Block(block.shape, block.colour, Pose(x, y, 0.0))
        for block, (x, y) in zip(scene.blocks, places, strict=True)
    ]
    return Scene(scene.robot, tuple(blocks), scene.regions)


def test_access_counts_walls_and_those_around() -> None:
    """A block that others and a wall enclose is hard to grasp until they are gone."""
    scene = blocks_at((-0.82, 0.0), (-0.62, -0.14), (-0.62, 0.14), (-0.82, 0.28), (0.4, 0.0))
    jumble = Jumble.of(sight_of(scene), lambda block: block.colour)
    alone = np.eye(5, dtype=np.bool_)
    enclosed, free = jumble.access(~alone), jumble.access(alone)
    assert enclosed[0] > 10.0  # measured: of those, more than four in five are never grasped
    assert enclosed[4] == 0.0
    assert free.max() < 8.0 + 1e-9  # one finger between block and wall at most
