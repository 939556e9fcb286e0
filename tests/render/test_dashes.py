"""The two ways in which the sides of goal regions advance the pattern of dashes."""

import numpy as np
import pytest
from numpy.typing import NDArray

from magical.render import Renderer
from magical.scene import Colour, Pose, Poses, Region, Scene

PIXEL = 2.04 / 384  # units


def render(width: float, height: float, whole: bool) -> NDArray[np.uint8]:
    """A region of a size in pixels, whose corners are at pixel centres on the top left."""
    region = Region(Colour.RED, -60.5 * PIXEL, 40.5 * PIXEL, height * PIXEL, width * PIXEL)
    scene = Scene(Pose(0.8, -0.8, 0.0), regions=(region,))
    frame = np.empty((384, 384, 3), np.uint8)
    Renderer(scene, "allo", 384, 1, whole_dashes=whole).render(Poses.at_rest(scene).bodies, frame)
    return frame


def right_side(frame: NDArray[np.uint8], width: int) -> NDArray[np.uint8]:
    """The green channel along the region's right side, from the top."""
    side: NDArray[np.uint8] = frame[152:232, 192 - 60 + width - 1, 1]
    return side


def test_sides_of_whole_lengths_are_the_same() -> None:
    np.testing.assert_array_equal(render(100, 80, True), render(100, 80, False))


@pytest.mark.parametrize("width", [100.4, 100.8])
def test_the_exact_length_shifts_the_dashes_round_the_corner(width: float) -> None:
    rounded, exact = render(width, 80, True), render(width, 80, False)
    top = slice(0, 150)
    np.testing.assert_array_equal(rounded[top], exact[top])
    # Rounded up, the top side counts 101 pixels; by its exact length, 100 whole ones.
    a, b = right_side(rounded, 101)[4:70], right_side(exact, 101)[5:71]
    assert not np.array_equal(a, right_side(exact, 101)[4:70])
    np.testing.assert_array_equal(a, b)
