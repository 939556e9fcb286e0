"""MakeLine's goals: lines that score fully, with few and short moves."""

import math
from itertools import combinations

import numpy as np

from magical.experts import MovePlan, Strategy, get_planner
from magical.experts.goals.make_line import is_line
from magical.scene import Poses
from magical.tasks import get_task
from tests.experts.scenes import blocks_at, view_of

PLANNER, TASK = get_planner("MakeLine"), get_task("MakeLine")
STRATEGY = Strategy.sample(np.random.default_rng(0))


def test_line_with_a_margin_scores_fully() -> None:
    rng, made = np.random.default_rng(0), 0
    for _ in range(300):
        along = np.cumsum(rng.uniform(0.2, 0.45, size=4))
        places = [
            (float(x) - 0.9, float(y)) for x, y in zip(along, rng.normal(0, 0.1, 4), strict=True)
        ]
        scene = blocks_at(*places)
        if is_line(places):
            made += 1
            assert TASK.score(scene, Poses.at_rest(scene)) == 1.0
    assert made > 20


def test_plan_solves_the_task_and_then_ends() -> None:
    view = view_of(TASK.demo)
    plan = PLANNER.plan_fn(view, STRATEGY, MovePlan())
    places = list(view.blocks)
    for move in plan.moves:
        assert move.block is not None
        places[move.block] = move.goal
    made = blocks_at(*places)
    assert TASK.score(made, Poses.at_rest(made)) == 1.0
    assert PLANNER.plan_fn(view_of(made), STRATEGY, MovePlan()).moves == ()
    assert PLANNER.solved_fn(view_of(made))


def test_a_line_with_one_gap_too_wide_asks_for_one_short_move() -> None:
    scene = blocks_at((0.0, -0.6), (0.0, -0.19), (0.0, 0.22), (0.0, 0.65))
    moves = PLANNER.plan_fn(view_of(scene), STRATEGY, MovePlan()).moves
    assert [move.block for move in moves] == [3]
    distance = math.dist(moves[0].goal, (0.0, 0.65))
    assert distance < 0.3
    assert moves[0].tolerance <= 0.5 * distance


def test_places_leave_room_between_blocks() -> None:
    rng = np.random.default_rng(1)
    for _ in range(30):
        scene = blocks_at(*((float(x), float(y)) for x, y in rng.uniform(-0.8, 0.8, size=(4, 2))))
        plan = PLANNER.plan_fn(view_of(scene), STRATEGY, MovePlan())
        moved = [move.block for move in plan.moves]
        for i, j in combinations(range(len(plan.places)), 2):
            if i in moved or j in moved:
                assert math.dist(plan.places[i], plan.places[j]) > 0.25
