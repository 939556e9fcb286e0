"""The renderer's interface: layouts, purity, threads, errors."""

import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from magical.errors import RenderError, UnknownNameError
from magical.render import Renderer, default_samples, render_frame, render_views
from magical.render.kernel import frame_kernel
from magical.scene import Poses, View
from tests.render.cases import Case, random_case

Image = NDArray[np.uint8]

LAYOUTS: dict[str, Callable[[], Image]] = {
    "contiguous": lambda: np.zeros((96, 96, 3), np.uint8),
    "newest of a stack": lambda: np.zeros((96, 96, 12), np.uint8)[:, :, -3:],
    "channels first": lambda: np.zeros((12, 96, 96), np.uint8).transpose(1, 2, 0)[:, :, -3:],
    "part of a batch": lambda: np.zeros((5, 96, 96, 3), np.uint8)[2],
    "strided": lambda: np.zeros((192, 192, 3), np.uint8)[::2, ::2],
    "upside down": lambda: np.zeros((96, 96, 3), np.uint8)[::-1, ::-1],
    "Fortran order": lambda: np.zeros((96, 96, 3), np.uint8, order="F"),
}


@pytest.mark.parametrize("view", list(View))
@pytest.mark.parametrize("layout", LAYOUTS)
def test_any_layout(layout: str, view: View, case: Case) -> None:
    out = LAYOUTS[layout]()
    Renderer(case[0], view).render(case[1].bodies, out)
    np.testing.assert_array_equal(out, render_frame(*case, view))


@pytest.mark.parametrize("view", list(View))
def test_published_pipeline(view: View, case: Case) -> None:
    raw = render_frame(*case, view, 384, 1).astype(float)
    reduced = np.rint(raw.reshape(96, 4, 96, 4, 3).mean(axis=(1, 3)))  # rounds halves to even
    np.testing.assert_array_equal(render_frame(*case, view, 96, 4), reduced)
    half = np.rint(raw.reshape(192, 2, 192, 2, 3).mean(axis=(1, 3)))
    np.testing.assert_array_equal(render_frame(*case, view, 192, 2), half)


def test_default_samples(case: Case) -> None:
    assert [default_samples(n) for n in (32, 96, 97, 128, 192, 383, 384, 1000)] == [
        4, 4, 4, 4, 2, 2, 1, 1,
    ]  # fmt: skip
    np.testing.assert_array_equal(render_frame(*case, "ego"), render_frame(*case, "ego", 96, 4))


@pytest.mark.parametrize("samples", [2.0, np.int64(2)])
def test_samples_of_another_type(samples: Any, case: Case) -> None:
    expected = render_frame(*case, "ego", 8, 2)
    frame_kernel.cache_clear()  # which finds kernels by a number of any type
    np.testing.assert_array_equal(render_frame(*case, "ego", 8, samples), expected)


def test_frames_depend_on_the_poses_alone_in_threads_too() -> None:
    cases = [random_case(seed) for seed in range(4)]
    renderers = [(Renderer(s, v, n), p) for s, p in cases for v in View for n in (96, 48)]
    expected = [_rendered(*entry) for entry in renderers]

    def render_often(renderer: Renderer, poses: Poses) -> list[Image]:
        return [_rendered(renderer, poses) for _ in range(300)]

    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        with ThreadPoolExecutor(len(renderers)) as pool:
            frames = list(pool.map(render_often, *zip(*renderers, strict=True)))
    finally:
        sys.setswitchinterval(interval)
    for rendered, one in zip(frames, expected, strict=True):
        assert all((frame == one).all() for frame in rendered)


def _rendered(renderer: Renderer, poses: Poses) -> Image:
    out = np.empty((renderer.size, renderer.size, 3), np.uint8)
    renderer.render(poses.bodies, out)
    return out


def test_importing_compiles_nothing() -> None:
    program = (
        "from numba.core import event\n"
        "with event.install_recorder('numba:compile') as recorder:\n"
        "    import magical.render\n"
        "assert not recorder.buffer\n"
    )
    subprocess.run([sys.executable, "-c", program], check=True)


def test_both_views_side_by_side(case: Case) -> None:
    both = render_views(*case)
    assert both.shape == (384, 768, 3)
    np.testing.assert_array_equal(both[:, :384], render_frame(*case, View.EGO, 384))
    np.testing.assert_array_equal(both[:, 384:], render_frame(*case, View.ALLO, 384))


def test_bodies_may_have_velocities_and_be_read_only(case: Case) -> None:
    table = np.concatenate([case[1].bodies, np.full_like(case[1].bodies, np.nan)], axis=1)
    table.flags.writeable = False
    out = np.empty((96, 96, 3), np.uint8)
    Renderer(case[0], "ego").render(table, out)
    np.testing.assert_array_equal(out, render_frame(*case, "ego"))


@pytest.mark.parametrize("value", [np.nan, np.inf, -1e9])
@pytest.mark.parametrize("place", [(0, 0), (2, 1), (6, 2)])
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
    bad_arrays: tuple[Any, ...] = (out[1:], out[:, :, :2], out.astype(np.float32), read_only)
    for bad in bad_arrays:
        with pytest.raises(RenderError, match="expected"):
            renderer.render(poses.bodies, bad)
    stack = np.empty((96, 96, 6), np.uint8)
    bad_stacks: tuple[Any, ...] = (stack[:90], stack * 1.0)
    for bad in bad_stacks:
        with pytest.raises(RenderError, match="expected"):
            renderer.render_stacked(poses.bodies, bad)
    for channels in (0, 2, 4):
        with pytest.raises(RenderError, match="of whole frames"):
            renderer.render_stacked(poses.bodies, np.empty((96, 96, channels), np.uint8))


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
