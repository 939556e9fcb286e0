"""The fast renderer equals the slow one, bit by bit."""

import numpy as np
import pytest

from magical.render import render_frame
from magical.scene import Block, Colour, Pose, Poses, Region, Scene, Shape, View
from tests.render.cases import random_case
from tests.render.reference_renderer import render as reference_render

SIZES = [(96, 4), (32, 1), (32, 4), (64, 2), (100, 4), (384, 1), (7, 2), (1, 1)]


@pytest.mark.parametrize("view", list(View))
@pytest.mark.parametrize(("size", "samples"), SIZES)
def test_random_scenes(size: int, samples: int, view: View) -> None:
    for seed in range(8):
        scene, poses = random_case(1000 * size + seed)
        expected = reference_render(scene, poses, view, size, samples)
        rendered = render_frame(scene, poses, view, size, samples)
        np.testing.assert_array_equal(rendered, expected, err_msg=f"seed {seed}")


@pytest.mark.parametrize("view", list(View))
@pytest.mark.parametrize("angle", [0.0, np.pi / 2, np.pi, 1e-12, np.pi / 4])
def test_vertical_and_horizontal_edges(angle: float, view: View) -> None:
    blocks = tuple(
        Block(shape, Colour.GREEN, Pose(0.3 * i - 0.5, 0.0, angle)) for i, shape in enumerate(Shape)
    )
    region = Region(Colour.BLUE, -0.34, 0.51, 0.68, 0.34)
    scene = Scene(Pose(0.0, -0.5, angle), blocks, (region,), robot_first=True)
    poses = Poses.at_rest(scene)
    expected = reference_render(scene, poses, view, 96, 4)
    np.testing.assert_array_equal(render_frame(scene, poses, view), expected)


def test_everything_out_of_view() -> None:
    block = Block(Shape.STAR, Colour.RED, Pose(900.0, -900.0, 1.0))
    far = Region.from_centre("red", 500.0, 500.0, 1.0, 2.0)
    scene = Scene(Pose(40.0, -70.0, 2.0), (block,), (far,))
    for view in View:
        poses = Poses.at_rest(scene)
        expected = reference_render(scene, poses, view, 32, 4)
        np.testing.assert_array_equal(render_frame(scene, poses, view, 32, 4), expected)
