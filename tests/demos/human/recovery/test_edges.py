"""Statements about edges near the pixels of a recorded frame."""

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from magical.demos.human.recovery.edge_search import MIXED
from magical.demos.human.recovery.edges import EdgeFinder, Edges
from magical.errors import RenderError
from magical.render import render_frame
from magical.scene import Block, Colour, Pose, Poses, Scene, Shape, View
from magical.scene.geometry import block_outline
from magical.scene.poses import EYES, FIRST_BLOCK, ROBOT
from tests.render.cases import random_case

SIZE = 384
PIXELS = SIZE / 2.04  # a unit


def find(scene: Scene, recorded: Poses, view: View, band: float, **changed: Any) -> Edges:
    """Edges in the frame of some poses, for the same poses or others."""
    finder = EdgeFinder(scene, view)
    labels = finder.label(render_frame(scene, recorded, view, SIZE, 1))
    bodies = changed.get("bodies", recorded.bodies)
    return finder.find(bodies, labels, band, np.ones(len(bodies), np.bool_))


@pytest.mark.parametrize("view", View)
@pytest.mark.parametrize("seed", range(5))
def test_true_poses_fulfil_every_statement(view: View, seed: int) -> None:
    scene, poses = random_case(seed)
    edges = find(scene, poses, view, 0.5)
    assert len(edges.margin) > 500
    # Vertices are rounded to 1/256 pixel when they are rendered.
    assert np.mean(edges.margin < -0.005) < 0.002
    assert set(edges.anchor.tolist()) <= set(range(-1, len(poses.bodies)))


def test_labels_name_colours() -> None:
    scene, poses = random_case(1)
    finder, frame = EdgeFinder(scene, View.EGO), render_frame(scene, poses, View.EGO, SIZE, 1)
    labels = finder.label(frame)[::-1]
    for label in np.unique(labels).tolist():
        colours = np.unique(frame[labels == label], axis=0)
        assert len(colours) == 1 or label == MIXED
    assert np.mean(labels == MIXED) < 0.1  # smoothed lines alone


def distances_inside(
    outline: NDArray[np.float64], x: NDArray[np.float64], y: NDArray[np.float64]
) -> NDArray[np.float64]:
    """How far inside a convex polygon points lie: the plain reference."""
    inside = np.full(x.shape, math.inf)
    for (x0, y0), (x1, y1) in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        length = math.hypot(x1 - x0, y1 - y0)
        inside = np.minimum(inside, ((x1 - x0) * (y - y0) - (y1 - y0) * (x - x0)) / length)
    return inside


def test_margins_against_a_plain_reference() -> None:
    pose = Pose(0.3, -0.2, 0.5)
    block = Block(Shape.PENTAGON, Colour.BLUE, pose)
    scene, band = Scene(Pose(-0.6, 0.6, 0.0), (block,)), 2.0
    edges = find(scene, Poses.at_rest(scene), View.ALLO, band)
    cos, sin = math.cos(pose.angle), math.sin(pose.angle)
    turn = np.array([[cos, sin], [-sin, cos]])
    outline = (np.array(block_outline(block.shape)) @ turn + pose[:2] + 1.02) * PIXELS
    y, x = np.indices((SIZE, SIZE)) + 0.5
    distances = np.abs(distances_inside(outline, x, y))
    expected = distances[distances <= band]
    found = np.abs(edges.margin[edges.anchor == FIRST_BLOCK])
    # Each distance from the outline is among the margins; the others are from the fill.
    assert len(found) > len(expected)
    nearest = np.abs(found - expected[:, None]).min(axis=1)
    assert np.mean(nearest < 1e-5) > 0.99  # a few lie beyond corners, further than the band


@pytest.mark.parametrize("view", View)
def test_derivatives_are_those_of_the_margins(view: View) -> None:
    scene, poses = random_case(3)
    before, step = find(scene, poses, view, 3.0), 2e-4
    for row in (ROBOT, 1, EYES.start, FIRST_BLOCK):
        for axis in (0, 1, 2):
            if row == EYES.start and axis < 2:
                continue
            bodies = poses.bodies.copy()
            bodies[row, axis] += step
            if row == ROBOT and axis < 2:
                bodies[EYES, axis] += step
            after = find(scene, poses, view, 3.0, bodies=bodies)
            measured = _by_pixel_order(before, after)
            if measured is None:
                continue
            expected = _derivative(before, view, row, axis)
            close = np.abs(measured / step - expected) < 0.02 * PIXELS
            assert close.mean() > 0.98


def _by_pixel_order(before: Edges, after: Edges) -> NDArray[np.float64] | None:
    """Changes of the margins, unless statements were added or dropped."""
    same = len(before.margin) == len(after.margin) and (before.anchor == after.anchor).all()
    return after.margin - before.margin if same else None


def _derivative(edges: Edges, view: View, row: int, axis: int) -> NDArray[np.float64]:
    mine = edges.anchor == row
    own = (edges.x, edges.y, edges.anchor_angle)[axis]
    total = np.where(mine, own, 0.0)
    if axis == 2:
        total += np.where((edges.turn == row) & (edges.turn != edges.anchor), edges.turn_angle, 0.0)
    if row == ROBOT and view == View.EGO:
        total += (-edges.x, -edges.y, edges.camera_angle)[axis]
    return total


def test_wanted_bodies_alone_are_found() -> None:
    scene = Scene(
        Pose(-0.6, 0.6, 0.0),
        (
            Block(Shape.SQUARE, Colour.RED, Pose(0.5, 0.5, 0.3)),
            Block(Shape.STAR, Colour.BLUE, Pose(-0.5, -0.5, 0.3)),
        ),
    )
    poses, wanted = Poses.at_rest(scene), np.zeros(7, np.bool_)
    wanted[6] = True
    finder = EdgeFinder(scene, View.ALLO)
    labels = finder.label(render_frame(scene, poses, View.ALLO, SIZE, 1))
    everything = find(scene, poses, View.ALLO, 1.0)
    star = finder.find(poses.bodies, labels, 1.0, wanted)
    assert set(star.anchor.tolist()) == {6}
    assert len(star.margin) == (everything.anchor == 6).sum()


@pytest.mark.parametrize(
    "bodies", [np.full((5, 3), np.nan), np.full((5, 3), 1e9), np.zeros((6, 3))]
)
def test_poses_and_frames_that_do_not_fit(bodies: NDArray[np.float64]) -> None:
    finder = EdgeFinder(Scene(Pose(0.0, 0.0, 0.0)), View.EGO)
    with pytest.raises(RenderError, match="expected 5 finite poses"):
        finder.find(bodies, np.zeros((SIZE, SIZE), np.uint8), 1.0, np.ones(5, np.bool_))
    with pytest.raises(RenderError, match="expected a frame 384 across"):
        finder.label(np.zeros((96, 96, 3), np.uint8))
