"""Quick overlap tests against the exact pieces."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from magical.scene import SHAPES, Block, Colour, Pose, Region, Shape
from magical.scene import geometry as g
from magical.scene.solids import Solid, block_silhouette, robot_silhouette

number = st.floats(-0.6, 0.6)
poses = st.builds(Pose, number, number, st.floats(-math.pi, math.pi))
blocks = st.builds(Block, st.sampled_from(SHAPES), st.just(Colour.RED), poses)
regions = st.builds(
    Region, st.just(Colour.RED), number, number, st.floats(0.1, 0.8), st.floats(0.1, 0.8)
)


solids = st.one_of(
    st.builds(Solid.of_block, blocks),
    st.builds(Solid.of_robot, poses),
    st.builds(Solid.of_region, regions),
)


@settings(max_examples=800, deadline=None)
@given(solids, solids)
def test_overlap_and_depth_are_those_of_the_exact_pieces(first: Solid, second: Solid) -> None:
    a, b = (g.place(each.silhouette.pieces, each.pose) for each in (first, second))
    exact = max(g.depth(p, q) for p in a for q in b)
    assert first.overlaps(second) == second.overlaps(first) == (exact > 0.0)
    assert first.depth(second) == pytest.approx(max(0.0, exact), abs=1e-12)


@settings(max_examples=200, deadline=None)
@given(blocks, st.floats(-0.5, 0.5))
def test_inside_the_workspace(block: Block, shift: float) -> None:
    moved = Block(block.shape, block.colour, block.pose._replace(x=0.85 + shift / 3))
    pieces = g.place(g.block_pieces(moved.shape), moved.pose)
    exact = all(max(map(abs, v)) + p.radius <= 1.0 for p in pieces for v in p.vertices)
    assert Solid.of_block(moved).is_inside() == exact
    assert (Solid.of_block(moved).beyond_wall() <= 0.0) == exact


@pytest.mark.parametrize("shape", SHAPES)
def test_inner_circle_is_inside_and_outer_around(shape: Shape) -> None:
    block = Block(shape, Colour.RED, Pose(0.0, 0.0, 0.3))
    solid, silhouette = Solid.of_block(block), block_silhouette(block.shape)
    for angle in np.linspace(0.0, 2 * math.pi, 97):
        for radius, touches in ((silhouette.inner - 1e-3, True), (silhouette.outer + 1e-3, False)):
            point = g.Piece(((radius * math.cos(angle), radius * math.sin(angle)),))
            found = any(g.depth(piece, point) >= 0.0 for piece, _, _ in solid.parts)
            assert found == touches


def test_robots_inner_circle_is_its_body() -> None:
    assert robot_silhouette().inner == 0.2
    assert 0.35 < robot_silhouette().outer < 0.45
