"""Shifting frame stacks."""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from magical.render import Renderer, render_frame, shift_stack
from magical.scene import View
from tests.render.cases import Case

Image = NDArray[np.uint8]


def _channels_first(size: int, channels: int) -> Image:
    return np.zeros((channels, size, size), np.uint8).transpose(1, 2, 0)


def _window(size: int, channels: int) -> Image:
    return np.zeros((size, size, channels + 5), np.uint8)[:, :, 3 : 3 + channels]


MAKERS: dict[str, Callable[[int, int], Image]] = {
    "contiguous": lambda size, channels: np.zeros((size, size, channels), np.uint8),
    "channels first": _channels_first,
    "window": _window,
    "window, channels first": lambda size, channels: _channels_first(size, channels + 3)[:, :, 3:],
}


@pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS)
@pytest.mark.parametrize("channels", [3, 6, 12])
def test_shift(make: Callable[[int, int], Image], channels: int) -> None:
    stack = make(10, channels)
    stack[:] = np.random.default_rng(0).integers(256, size=stack.shape)
    before = stack.copy()
    shift_stack(stack)
    np.testing.assert_array_equal(stack[:, :, :-3], before[:, :, 3:])


@pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS)
@pytest.mark.parametrize("view", list(View))
@pytest.mark.parametrize("channels", [3, 6, 12])
def test_render_stacked(
    make: Callable[[int, int], Image], channels: int, view: View, case: Case
) -> None:
    scene, poses = case
    renderer, newest = Renderer(scene, view, 32), render_frame(scene, poses, view, 32)
    stack = make(32, channels)
    stack[:] = np.random.default_rng(1).integers(256, size=stack.shape)
    before = stack.copy()
    expected = np.concatenate([before[:, :, 3:], newest], axis=2)

    renderer.render_stacked(poses.bodies, stack)
    np.testing.assert_array_equal(stack, expected)


def test_only_the_window_is_written(case: Case) -> None:
    renderer = Renderer(case[0], View.EGO)
    for render, end in ((renderer.render, 6), (renderer.render_stacked, 9)):
        whole = np.full((96, 96, 12), 77, np.uint8)
        render(case[1].bodies, whole[:, :, 3:end])
        assert (whole[:, :, :3] == 77).all()
        assert (whole[:, :, end:] == 77).all()
