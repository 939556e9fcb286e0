"""The scripted expert for any program: the moves that its goals ask for."""

import math
from collections.abc import Iterator
from functools import partial

import numpy as np

from magical.errors import NoExpertError
from magical.experts.goals.clustering import cluster_planner
from magical.experts.goals.make_line import plan_line
from magical.experts.goals.regions import moves_in, moves_out, place_on_grid
from magical.experts.planning import Move, MovePlan, Planner, Strategy
from magical.experts.state_view import StateView
from magical.scene import FIRST_BLOCK, Point, Poses
from magical_goals.language import expressions as e
from magical_goals.language import goals as g
from magical_goals.language.expressions import Place, value_of
from magical_goals.language.goals import Goal
from magical_goals.language.programs import program_of

MARGIN = 0.06  # units within a corner, wall zone or neighbourhood to aim for
TOLERANCE = 0.06  # units
PLACED = g.Each | g.Every | g.OneOf  # goals that blocks are at places
AROUND = MARGIN * np.array([(1, 0), (-1, 0), (0, 1), (0, -1)])  # (4, 2)


def planner_of(task: str) -> Planner:
    """The planner of a task that has a program."""
    return program_planner(program_of(task))


def program_planner(program: Goal) -> Planner:
    """The planner for a program."""
    if isinstance(program, g.Clustered):
        return cluster_planner(partial(value_of, attribute=program.attribute))
    return Planner(partial(plan, program), partial(is_solved, program))


def plan(program: Goal, view: StateView, strategy: Strategy, last: MovePlan) -> MovePlan:
    """The moves that the program's goals ask for; the first goal to move a block decides."""
    if isinstance(program, g.Lined):
        chosen = sorted(program.selection.blocks(view.scene))
        return plan_line(view, chosen, strategy, last)
    moves: dict[int | None, Move] = {}
    for goal in _goals(program):
        for move in _moves(goal, view, strategy):
            moves.setdefault(move.block, move)
    return MovePlan(tuple(moves.values()))


def is_solved(program: Goal, view: StateView) -> bool:
    """Whether the score is 1 once the blocks have come to rest."""
    rows = np.zeros((FIRST_BLOCK + len(view.blocks), 3))
    rows[0] = view.x, view.y, view.angle
    rows[FIRST_BLOCK:, :2] = np.reshape(view.resting_blocks, (-1, 2))
    return program.score(view.scene, Poses(rows)) == 1.0


def _goals(program: Goal) -> Iterator[Goal]:
    if isinstance(program, g.Together):
        yield from _goals(program.first)
        yield from _goals(program.second)
    elif isinstance(program, g.Exactly):
        yield from _goals(program.both)
    elif isinstance(program, g.Only):
        yield program.others
    else:
        yield program


def _moves(goal: Goal, view: StateView, strategy: Strategy) -> list[Move]:
    """Moves for one goal."""
    if isinstance(goal, g.Undisturbed):
        return _back(goal, view, strategy)
    if not isinstance(goal, PLACED):
        raise NoExpertError(f"no expert for {goal!r} in a program; register a planner of your own")
    blocks = sorted(goal.selection.blocks(view.scene))
    if isinstance(goal, g.OneOf) and any(_is_there(goal.place, view, i) for i in blocks):
        return []
    return [move for i in blocks for move in _to_place(goal.place, view, strategy, i)]


def _to_place(place: Place, view: StateView, strategy: Strategy, block: int) -> list[Move]:
    """The move that brings a block to a place, or none if it is already there."""
    if isinstance(place, e.OutOfRegions):
        return moves_out(view, strategy, [block])
    if isinstance(place, e.InRegion | e.InOwnColour):
        colour = view.scene.blocks[block].colour
        fitting = [
            r for r in view.scene.regions if isinstance(place, e.InRegion) or r.colour == colour
        ]
        nearest = min(fitting, key=lambda region: math.dist(region.centre, view.blocks[block]))
        return moves_in(view, strategy, nearest, [block])
    if _is_there(place, view, block):
        return []
    goal = place_on_grid(view, strategy, block, partial(_is_well_within, place, view, block))
    return [Move(goal, TOLERANCE, block)]


def _is_there(place: Place, view: StateView, block: int) -> bool:
    return place.degree(view.scene, block, view.resting_blocks) >= 1.0


def _is_well_within(place: Place, view: StateView, block: int, point: Point) -> bool:
    """Whether a block would be at a place at all four points `MARGIN` away from a point."""
    points = np.repeat(np.array(view.blocks)[None], len(AROUND), axis=0)
    points[:, block] = point + AROUND
    return bool((place.remaining(view.scene, points)[:, block] <= 0.0).all())


def _back(goal: g.Undisturbed, view: StateView, strategy: Strategy) -> list[Move]:
    """Moves that return blocks to the regions of the selected ones, and take others out."""
    moves, chosen = [], goal.selection.blocks(view.scene)
    for region in view.scene.regions:
        starts = {i for i, b in enumerate(view.scene.blocks) if region.contains(*b.pose[:2])}
        if starts & chosen:
            others = [i for i, at in enumerate(view.blocks) if region.contains(*at)]
            moves += moves_in(view, strategy, region, starts)
            moves += moves_out(view, strategy, set(others) - starts)
    return moves
