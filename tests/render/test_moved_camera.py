"""Frames from a moved camera, beside plain frames that are moved."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from magical.errors import RenderError
from magical.render import render_frame
from magical.render.moved_camera import MovedCamera
from magical.scene import Poses, View
from tests.render.cases import Case, random_case

SIZE = 96
VIEWS = list(View)


def moved(
    case: Case,
    view: View,
    angle: float = 0.0,
    shift: Any = (0.0, 0.0),
    size: int = SIZE,
    palette: NDArray[np.uint8] | None = None,
    without_walls: bool = False,
) -> NDArray[np.float32]:
    """One frame from a moved camera, (size, size, 3) in [0, 255]."""
    scene, poses = case
    camera = MovedCamera(scene, view, size)
    out = np.full((1, size, size, 3), np.nan, np.float32)
    bodies = np.asarray(poses.bodies)[None, None, :, :3]
    colours = camera.palette if palette is None else palette
    moves, hidden = (np.array([angle]), np.array([shift])), np.array([without_walls])
    camera.render(bodies, *moves, colours[None], hidden, out, np.zeros(1, int), 0)
    return np.asarray(out[0] * 255.0)


def plain(case: Case, view: View, size: int = SIZE) -> NDArray[np.float64]:
    return render_frame(*case, view, size).astype(float)


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("seed", range(4))
def test_a_camera_at_rest_renders_the_plain_frame(view: View, seed: int) -> None:
    case = random_case(seed)
    np.testing.assert_allclose(moved(case, view), plain(case, view), atol=1e-4)


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize(("right", "down"), [(4, 0), (0, -3), (-2, 4)])
def test_shift_by_whole_pixels_moves_the_frame(
    case: Case, view: View, right: int, down: int
) -> None:
    found = moved(case, view, shift=(right / SIZE, down / SIZE))
    expected = np.roll(plain(case, view), (down, right), axis=(0, 1))
    inside = slice(5, -5)
    np.testing.assert_allclose(found[inside, inside], expected[inside, inside], atol=1e-4)


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("angle", [0.08, -0.05])
def test_turned_and_shifted_frame_agrees_with_a_resampled_one(
    case: Case, view: View, angle: float
) -> None:
    """The reference: a frame four times as large, resampled, then averaged."""
    ndimage = pytest.importorskip("scipy.ndimage")
    shift, large = np.array([0.03, -0.02]), 4 * SIZE
    cos, sin = np.cos(angle), np.sin(angle)
    # Rows go down, so that a counter-clockwise turn has this inverse in (row, column).
    inverse = np.array([[cos, sin], [-sin, cos]])
    centre = np.full(2, (large - 1) / 2)
    offset = centre - inverse @ (centre + large * shift[::-1])
    picture = plain(case, view, large)
    warped = np.stack(
        [ndimage.affine_transform(picture[..., k], inverse, offset, order=1) for k in range(3)],
        axis=-1,
    )
    expected = warped.reshape(SIZE, 4, SIZE, 4, 3).mean(axis=(1, 3))
    difference = np.abs(moved(case, view, angle, shift) - expected)[12:-12, 12:-12]
    assert difference.mean() < 1.5
    assert np.abs(plain(case, view) - expected)[12:-12, 12:-12].mean() > 4 * difference.mean()


def test_what_is_beyond_the_border_is_shown(case: Case) -> None:
    """Half of the frame moves to the other side, and its place is taken by what was out of view.

    Lines and dashes of regions are clipped at the frame's border, so they differ a little.
    """
    before, after = moved(case, View.EGO), moved(case, View.EGO, shift=(0.5, 0.0))
    left, right = slice(SIZE // 2), slice(SIZE // 2, None)
    assert (np.abs(after[:, right] - before[:, left]) < 1e-3).mean() > 0.95
    for other in (before[:, left], before[:, right], before[:, left][:, ::-1]):
        assert (np.abs(after[:, left] - other) < 1e-3).mean() < 0.9
    assert after[:, left].std() > 1.0


def test_every_stack_has_its_own_colours_row_and_channels(case: Case) -> None:
    scene, poses = case
    camera = MovedCamera(scene, View.EGO, SIZE)
    dark = (camera.palette * 0.5).astype(np.uint8)
    bodies = np.repeat(np.asarray(poses.bodies)[None, None, :, :3], 2, axis=0)
    bodies = np.repeat(bodies, 2, axis=1)  # (2 stacks, 2 frames)
    out = np.zeros((3, SIZE, SIZE, 9), np.float32)
    palettes = np.stack([camera.palette, dark])
    rows = np.array([2, 0])
    camera.render(bodies, np.zeros(2), np.zeros((2, 2)), palettes, np.zeros(2, bool), out, rows, 3)
    whole = plain(case, View.EGO) / 255.0
    for first in (3, 6):
        np.testing.assert_allclose(out[2, :, :, first : first + 3], whole, atol=1e-6)
        np.testing.assert_allclose(out[0, :, :, first : first + 3], 0.5 * whole, atol=0.005)
    assert not out[:, :, :, :3].any()
    assert not out[1].any()


def test_palette_holds_the_scene_s_colours(case: Case) -> None:
    palette = {tuple(colour) for colour in MovedCamera(case[0], View.EGO, SIZE).palette.tolist()}
    assert (255, 255, 255) in palette  # the workspace
    assert (231, 231, 234) in palette  # inside the fingers
    assert len(palette) >= 2 * len(case[0].blocks)


def test_poses_that_do_not_fit_are_an_error(case: Case) -> None:
    scene, poses = case
    bad = poses.bodies.copy()
    bad[0, 0] = np.nan
    with pytest.raises(RenderError, match="finite poses"):
        moved((scene, Poses(bad)), View.EGO)
    with pytest.raises(RenderError, match=r"expected poses \(..., 9, 3\), found \(1, 1, 8, 3\)"):
        moved((scene, Poses(poses.bodies[:-1])), View.EGO)
    with pytest.raises(RenderError, match="expected a size from 1"):
        MovedCamera(scene, View.EGO, 0)
