"""The renderer's interface: layouts, stacks, purity, threads, errors."""

import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest

from magical.errors import RenderError, UnknownNameError
from magical.render import Renderer, default_samples, render_frame, render_views, shift_stack
from magical.scene import Colour, Pose, Poses, Region, Scene, View
from tests.render.cases import Case, random_case

Image = np.ndarray
LAYOUTS: dict[str, Any] = {  # of (size, size, channels)
    "contiguous": lambda n, c: np.zeros((n, n, c), np.uint8),
    "channels first": lambda n, c: np.zeros((c, n, n), np.uint8).transpose(1, 2, 0),
    "window": lambda n, c: np.zeros((n, n, c + 5), np.uint8)[:, :, 3 : 3 + c],
    "window, channels first": lambda n, c: np.zeros((c + 3, n, n), np.uint8).transpose(1, 2, 0)[
        :, :, 3:
    ],
    "upside down": lambda n, c: np.zeros((n, n, c), np.uint8)[::-1, ::-1],
    "Fortran order": lambda n, c: np.zeros((n, n, c), np.uint8, order="F"),
}


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("channels", [3, 6, 12])
def test_frames_and_stacks_of_any_layout(layout: str, channels: int, case: Case) -> None:
    for view in View:
        renderer, newest = Renderer(case[0], view, 32), render_frame(*case, view, 32)
        stack = LAYOUTS[layout](32, channels)
        stack[:] = np.random.default_rng(1).integers(256, size=stack.shape)
        expected = np.concatenate([stack[:, :, 3:], newest], axis=2)
        shifted = stack.copy()
        shift_stack(shifted)
        np.testing.assert_array_equal(shifted[:, :, :-3], expected[:, :, :-3])
        renderer.render_stacked(case[1].bodies, stack)
        np.testing.assert_array_equal(stack, expected)
        stack[:, :, -3:] = 0
        renderer.render(case[1].bodies, stack[:, :, -3:])
        np.testing.assert_array_equal(stack, expected)


def test_only_the_window_is_written(case: Case) -> None:
    renderer = Renderer(case[0], View.EGO)
    for render, end in ((renderer.render, 6), (renderer.render_stacked, 9)):
        whole = np.full((96, 96, 12), 77, np.uint8)
        render(case[1].bodies, whole[:, :, 3:end])
        assert (whole[:, :, :3] == 77).all()
        assert (whole[:, :, end:] == 77).all()


@pytest.mark.parametrize("view", list(View))
def test_published_pipeline(view: View, case: Case) -> None:
    raw = render_frame(*case, view, 384, 1).astype(float)
    reduced = np.rint(raw.reshape(96, 4, 96, 4, 3).mean(axis=(1, 3)))  # rounds halves to even
    np.testing.assert_array_equal(render_frame(*case, view), reduced)
    half = np.rint(raw.reshape(192, 2, 192, 2, 3).mean(axis=(1, 3)))
    np.testing.assert_array_equal(render_frame(*case, view, 192), half)


def test_default_samples() -> None:
    sizes = {32: 4, 96: 4, 97: 4, 128: 4, 192: 2, 383: 2, 384: 1, 1000: 1}
    assert {size: default_samples(size) for size in sizes} == sizes


def test_frames_depend_on_the_poses_alone_in_threads_too() -> None:
    cases = [random_case(seed) for seed in range(4)]
    renderers = [(Renderer(s, v, n), p) for s, p in cases for v in View for n in (96, 48)]

    def rendered(renderer: Renderer, poses: Poses) -> Image:
        out = np.empty((renderer.size, renderer.size, 3), np.uint8)
        renderer.render(poses.bodies, out)
        return out

    expected = [rendered(*entry) for entry in renderers]

    def render_often(renderer: Renderer, poses: Poses) -> list[Image]:
        return [rendered(renderer, poses) for _ in range(100)]

    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        with ThreadPoolExecutor(len(renderers)) as pool:
            frames = list(pool.map(render_often, *zip(*renderers, strict=True)))
    finally:
        sys.setswitchinterval(interval)
    for many, one in zip(frames, expected, strict=True):
        assert all((frame == one).all() for frame in many)


def test_importing_compiles_nothing() -> None:
    program = (
        "from numba.core import event\n"
        "with event.install_recorder('numba:compile') as recorder:\n"
        "    import magical.render\n"
        "assert not recorder.buffer\n"
    )
    subprocess.run([sys.executable, "-c", program], check=True)


def test_both_views_side_by_side(case: Case) -> None:
    frames = [render_frame(*case, view, 384) for view in (View.EGO, View.ALLO)]
    np.testing.assert_array_equal(render_views(*case), np.concatenate(frames, axis=1))


def test_bodies_may_have_velocities_and_be_read_only(case: Case) -> None:
    table = np.concatenate([case[1].bodies, np.full_like(case[1].bodies, np.nan)], axis=1)
    table.flags.writeable = False
    out = np.empty((96, 96, 3), np.uint8)
    Renderer(case[0], "ego").render(table, out)
    np.testing.assert_array_equal(out, render_frame(*case, "ego"))


PIXEL = 2.04 / 384  # units


@pytest.mark.parametrize("width", [100, 100.4, 100.8])
def test_exact_dashes_shift_round_the_corner_of_a_side_that_is_not_whole(width: float) -> None:
    """As in the frames of the human demonstrations; corners are at pixel centres, top left."""
    region = Region(Colour.RED, -60.5 * PIXEL, 40.5 * PIXEL, 80 * PIXEL, width * PIXEL)
    scene = Scene(Pose(0.8, -0.8, 0.0), regions=(region,))
    frames = np.empty((2, 384, 384, 3), np.uint8)
    for frame, whole in zip(frames, (True, False), strict=True):
        renderer = Renderer(scene, "allo", 384, 1, whole_dashes=whole)
        renderer.render(Poses.at_rest(scene).bodies, frame)
    np.testing.assert_array_equal(frames[0, :150], frames[1, :150])
    if width == 100:
        np.testing.assert_array_equal(*frames)
        return
    # Rounded up, the top side counts 101 pixels; by its exact length, 100 whole ones.
    rounded, exact = frames[:, 152:232, 192 - 60 + 100, 1]  # the right sides, from the top
    assert not np.array_equal(rounded[4:70], exact[4:70])
    np.testing.assert_array_equal(rounded[4:70], exact[5:71])


@pytest.mark.parametrize("value", [np.nan, np.inf, -1e9])
@pytest.mark.parametrize("place", [(0, 0), (6, 2)])
def test_poses_out_of_range(value: float, place: tuple[int, int], case: Case) -> None:
    bodies = case[1].bodies.copy()
    bodies[place] = value
    for view in View:
        with pytest.raises(RenderError, match="finite"):
            Renderer(case[0], view).render(bodies, np.empty((96, 96, 3), np.uint8))


def test_arrays_of_other_shapes_and_types(case: Case) -> None:
    scene, poses = case
    renderer, out = Renderer(scene, "allo"), np.empty((96, 96, 3), np.uint8)
    for bodies in (poses.bodies[:-1], poses.bodies[:, :2], poses.bodies[0]):
        with pytest.raises(RenderError, match="9 bodies"):
            renderer.render(bodies, out)
    read_only = out.copy()
    read_only.flags.writeable = False
    others: Any = (out[1:], out[:, :, :2], out.astype(np.float32), read_only, out[:, :, :0])
    for bad in others:
        for render in (renderer.render, renderer.render_stacked):
            with pytest.raises(RenderError, match="expected"):
                render(poses.bodies, bad)


@pytest.mark.parametrize(
    ("size", "samples"),
    [(0, 1), (-4, None), (96, 3), (96, 0), (9.5, 1), (5000, 1), (4096, 4), (1025, 4)],
)
def test_invalid_sizes_and_samples(size: Any, samples: int | None, case: Case) -> None:
    with pytest.raises(RenderError, match=r"samples .* at most 4096 across"):
        Renderer(case[0], "ego", size, samples)


def test_unknown_view(case: Case) -> None:
    with pytest.raises(UnknownNameError, match="ego, allo"):
        Renderer(case[0], "side")
