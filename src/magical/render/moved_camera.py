"""Frames from a rotated and shifted camera, in other colours: augmentation without resampling."""

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from magical.compiled.jit import inlined, nogil_entry_point
from magical.errors import RenderError
from magical.render.canvas import Canvas, finish_bodies, finish_ground, working_memory
from magical.render.display import FURTHEST, display_list
from magical.render.frame import (
    BACKGROUND,
    Pixels,
    body_frames,
    render_bodies,
    render_ground,
    within_reach,
)
from magical.render.output import CHANNELS
from magical.render.polygons import SUBSAMPLES, Floats, Ints
from magical.render.renderer import checked_samples
from magical.scene.poses import FIRST_BLOCK
from magical.scene.scene import Scene
from magical.scene.vocabulary import View

LANE_BITS = 16 * np.arange(CHANNELS)  # the lowest bits of a packed colour's lanes (`palette.lanes`)

Floats32 = NDArray[np.float32]


class MovedCamera:
    """Renders frame stacks of one scene in one view, each stack with its own camera and colours.

    The camera's rotation and shift move the whole picture, as `resample` does, but what lies beyond
    the frame's borders comes into view, and edges are as sharp as in any frame.

    Args:
        scene: which bodies and regions there are; its poses are not used, except the regions'.
        view: of the camera.
        size: height and width of the frames in pixels.
        samples: as for `Renderer`.

    Raises:
        RenderError: as for `Renderer`.
    """

    def __init__(self, scene: Scene, view: View, size: int, samples: int | None = None) -> None:
        self._size = size
        self._samples = checked_samples(size, samples)
        self._ego = view == View.EGO
        self._display = display_list(scene)
        self._count = FIRST_BLOCK + len(scene.blocks)
        colours = self._display.items[:, 4], self._display.colours.ravel(), [BACKGROUND]
        packed = np.concatenate(colours)
        self._palette, self._entries = np.unique(packed, return_inverse=True)

    @property
    def palette(self) -> NDArray[np.uint8]:
        """The scene's colours: (n, 3), 8-bit RGB."""
        return (self._palette[:, None] >> LANE_BITS).astype(np.uint8)

    def render(
        self,
        bodies: Floats,
        angles: Floats,
        shifts: Floats,
        palettes: NDArray[np.uint8],
        without_walls: NDArray[np.bool_],
        out: Floats32,
        rows: Ints,
        channel: int,
    ) -> None:
        """Render B stacks of K frames into `out`.

        Args:
            bodies: (B, K, 5 + blocks, 3): x, y, angle in the rows of `Poses`.
            angles: (B,) radians, counter-clockwise in the picture.
            shifts: (B, 2) to the right and down, as fractions of width and height.
            palettes: (B, n, 3) the colours in place of `palette`.
            without_walls: (B,) whether to give the workspace's edge, and what is beyond it, the
                workspace's colour.
            out: (N, size, size, C) float32; frames are written with values in [0, 1].
            rows: (B,) where in `out` each stack goes.
            channel: the first of its 3 * K channels.

        Raises:
            RenderError: the poses are not finite, out of range, or not one for each body.
        """
        if bodies.shape[2:] != (self._count, 3):
            raise RenderError(f"expected poses (..., {self._count}, 3), found {bodies.shape}")
        packed, count = self._colours(palettes, without_walls), len(self._display.items)
        moves = np.stack([np.cos(angles), np.sin(angles), shifts[:, 0], -shifts[:, 1]], axis=1)
        good = compiled_render_moved(self._samples)(
            np.ascontiguousarray(bodies),
            moves,
            self._display.vertices,
            self._display.items,
            np.ascontiguousarray(packed[:, :count]),
            self._display.offsets,
            self._display.ground,
            packed[:, count:-1].reshape(len(bodies), -1, 2),
            np.ascontiguousarray(packed[:, -1]),
            self._ego,
            out,
            rows,
            channel,
            *working_memory(self._size, self._samples, len(self._display.ground)),
        )
        if not good:
            raise RenderError(f"expected finite poses within {FURTHEST:g} units")

    def _colours(self, palettes: NDArray[np.uint8], without_walls: NDArray[np.bool_]) -> Ints:
        """The packed colours of items, ground and background: (B, items + 2 * ground + 1)."""
        lanes = palettes.astype(np.int64) << LANE_BITS  # (B, n, 3)
        packed: Ints = lanes.sum(axis=2)[:, self._entries]
        inside = len(self._display.items)  # the workspace is the first on the ground
        for place in (inside + 1, -1):  # its edge, and the background
            packed[without_walls, place] = packed[without_walls, inside]
        return packed


@inlined
def _move(frames: Floats, move: Floats, extent: float) -> None:
    """Rotate all frames (see `body_frames`) about the picture's centre, then shift them."""
    cos, sin = move[0], move[1]
    whole = SUBSAMPLES * extent
    for i in range(len(frames)):
        x, y = frames[i, 2] - whole / 2, frames[i, 3] - whole / 2
        frames[i, 0], frames[i, 1] = (
            cos * frames[i, 0] - sin * frames[i, 1],
            sin * frames[i, 0] + cos * frames[i, 1],
        )
        frames[i, 2] = cos * x - sin * y + whole / 2 + move[2] * whole
        frames[i, 3] = sin * x + cos * y + whole / 2 + move[3] * whole


@inlined
def _store(frames: Pixels, out: Floats32, channel: int) -> None:
    """Write K frames (K, P), lowest row first, into 3 * K channels of `out` (H, W, C)."""
    height, width = out.shape[0], out.shape[1]
    scale = np.float32(1.0 / 255)
    for y in range(height):
        first = (height - 1 - y) * width
        for x in range(width):
            target = out[y, x, channel:]
            for k in range(len(frames)):
                colour = frames[k, first + x]
                target[CHANNELS * k] = (colour & 0xFF) * scale
                target[CHANNELS * k + 1] = (colour >> 8 & 0xFF) * scale
                target[CHANNELS * k + 2] = (colour >> 16 & 0xFF) * scale


@cache
def compiled_render_moved(samples: int) -> Callable[..., bool]:
    """The entry point for samples x samples samples per pixel (1, 2 or 4 across)."""

    @nogil_entry_point
    def render_moved(
        bodies: Floats,
        moves: Floats,
        vertices: Floats,
        items: Ints,
        item_colours: Ints,
        offsets: Floats,
        corners: Floats,
        ground_colours: Ints,
        backgrounds: Ints,
        ego: bool,
        out: Floats32,
        rows: Ints,
        channel: int,
        *memory: NDArray[Any],
    ) -> bool:
        """Render the stacks of `bodies` (B, K, n, 3) into `out`; false for poses out of range.

        `moves` (B, 4): cos, sin, and shifts to the right and up. Each stack has its own
        `item_colours` (B, n), `ground_colours` (B, 1 + R, 2) and `backgrounds` (B,). The memory is
        that of `canvas.working_memory`.
        """
        size, stacked, count = out.shape[1], bodies.shape[1], bodies.shape[2]
        extent, stack = size * samples, np.empty((stacked, size * size), np.int32)
        frames, coloured = np.empty((count + 1, 4)), items.copy()
        for b in range(len(bodies)):
            coloured[:, 4] = item_colours[b]
            for k in range(stacked):
                if not within_reach(bodies[b, k]):
                    return False
                canvas = Canvas(size, samples, stack[k], stack[k], *memory)
                canvas.counts[0] = 0
                body_frames(bodies[b, k], ego, extent, frames)
                _move(frames, moves[b], extent)
                colours, outside, area = ground_colours[b], backgrounds[b], frames[count]
                render_ground(canvas, corners, colours, outside, area, ego, True)
                render_bodies(canvas, vertices, coloured, offsets, frames)
                finish_bodies(canvas)
                finish_ground(canvas)
            _store(stack, out[rows[b]], channel)
        return True

    return render_moved
