"""Overlap of solids: by the separating axis test on convex pieces, written from the outlines."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from magical.physics.overlap import Kind, Solids
from magical.scene import (
    SHAPES,
    Colour,
    Pose,
    Region,
    Shape,
    block_outline,
    rectangle,
    robot_polygons,
    to_workspace,
)
from magical.scene import constants as c
from magical.tasks.placement import OVERLAP_SLACK

Piece = tuple[list[tuple[float, float]], float]  # a convex polygon or a point, and its radius

number = st.floats(-0.6, 0.6)
poses = st.builds(Pose, number, number, st.floats(-math.pi, math.pi))
sizes = st.floats(0.1, 0.8)
regions = st.builds(Region, st.just(Colour.RED), number, number, sizes, sizes)
placed = st.tuples(st.sampled_from([None, *SHAPES]) | regions, poses)


def pieces(kind: Kind, pose: Pose) -> list[Piece]:
    if isinstance(kind, Region):
        outlines: Any = [(rectangle(kind.width, kind.height), 0.0)]
    elif kind is None:
        centre = ((0.0, 0.0),)
        outlines = [(centre, c.ROBOT_RADIUS), *((polygon, 0.0) for polygon in robot_polygons())]
    elif kind == Shape.CIRCLE:
        outlines = [(((0.0, 0.0),), c.BLOCK_SIZE)]
    elif kind == Shape.STAR:
        star = block_outline(kind)
        kites = [(star[i - 1], star[i], star[i + 1], (0.0, 0.0)) for i in range(0, 10, 2)]
        outlines = [(kite, 0.0) for kite in kites]
    else:
        outlines = [(block_outline(kind), c.SQUARE_MARGIN if kind == Shape.SQUARE else 0.0)]
    return [([to_workspace(v, pose) for v in outline], radius) for outline, radius in outlines]


def depth(a: Piece, b: Piece) -> float:
    """How far two pieces overlap along the best separating direction."""
    points = [np.array(vertices) for vertices, _ in (a, b)]
    edges = [p - np.roll(p, 1, axis=0) for p in points if len(p) > 1]
    between = (points[0][:, None] - points[1][None]).reshape(-1, 2)
    axes = [np.stack([e[:, 1], -e[:, 0]], axis=1) for e in edges] + [between] * bool(a[1] or b[1])
    directions = np.concatenate([*axes, [(1.0, 0.0)]])  # any bounds the overlap
    directions = directions[np.hypot(*directions.T) > 0]
    directions /= np.hypot(*directions.T)[:, None]
    first, second = (directions @ p.T for p in points)
    gaps = np.maximum(
        second.min(axis=1) - first.max(axis=1), first.min(axis=1) - second.max(axis=1)
    )
    return float(a[1] + b[1] - gaps.max())


@settings(max_examples=300, deadline=None)
@given(placed, placed)
@example(
    (Region(Colour.RED, 0.0, 0.0, 0.5, 0.125), Pose(0.0625, 0.0, 0.0)),
    (Region(Colour.RED, 0.0, 0.0, 0.5, 0.1), Pose(0.0, 0.0, 0.0)),
)
def test_overlap_and_depth_are_those_of_the_separating_axis_test(
    one: tuple[Kind, Pose], two: tuple[Kind, Pose]
) -> None:
    expected = max(depth(p, q) for p in pieces(*one) for q in pieces(*two))
    solids = Solids.cleared()
    first, second = solids.take(one[0]), solids.take(two[0])
    first.move(one[1])
    solids.place(first)
    second.move(two[1])
    found = list(solids.overlaps(second))
    assert {solid for solid, _ in found} <= {first}
    assert bool(found) == (expected > 0.0) or abs(expected) < 1e-12
    deepest = max((by for _, by in found), default=0.0)
    if expected > 0.05:  # further than any scene may
        assert deepest > OVERLAP_SLACK
    elif not {one[0], two[0]} & {None, Shape.STAR}:  # which have several pieces
        assert deepest == pytest.approx(max(0.0, expected), abs=1e-9)


@settings(max_examples=200, deadline=None)
@given(st.sampled_from([None, *SHAPES]), poses, st.floats(0.5, 0.9))
def test_beyond_the_wall(kind: Kind, pose: Pose, x: float) -> None:
    pose = pose._replace(x=x)
    reach = max(
        abs(v) + radius for vertices, radius in pieces(kind, pose) for v in sum(vertices, ())
    )
    solid = Solids.cleared().take(kind)
    solid.move(pose)
    assert solid.beyond_wall == pytest.approx(reach - 1.0, abs=1e-12)
