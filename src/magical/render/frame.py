"""A whole frame: cameras, ground, bodies, and the compiled entry point."""

import math
from collections.abc import Callable
from functools import cache

import numpy as np
from numpy.typing import NDArray

from magical.compiled.jit import inlined, integer, merged, nogil_entry_point, rint
from magical.render.canvas import Canvas, cover, finish_bodies, finish_ground, pack, paint
from magical.render.display import FURTHEST
from magical.render.lines import outline, round_up
from magical.render.palette import OUTSIDE, lanes
from magical.render.polygons import CORNER_X, CORNER_Y, SUBSAMPLES, Floats, Ints, X, Y, place, scan
from magical.scene.constants import RAW_FRAME_SIZE

VIEW_WIDTH = 2.04  # units: the width that both cameras show (docs/specification.md, section 6)
ROBOT_HEIGHT = 0.15  # of the frame: the robot's height above its lower edge, in the egocentric view
# Modes of the compiled `render`: everything, with `ground` the same array as `pixels`; only the
# allocentric ground; bodies over such a ground, whose finished pixels are in `kept`.
EGO, GROUND, ALLO = 0, 1, 2
BACKGROUND = lanes(OUTSIDE)

Pixels = NDArray[np.int32]


@merged
def body_frames(bodies: Floats, ego: bool, extent: float, frames: Floats) -> None:
    """Compute each body's frame on the grid, the workspace's last: scaled cos and sin, x, y."""
    scale = SUBSAMPLES * extent / VIEW_WIDTH
    x, y, turn, height = 0.0, 0.0, 0.0, 0.5  # the camera's pose, and its height in the frame
    if ego:
        x, y, turn, height = bodies[0, 0], bodies[0, 1], bodies[0, 2], ROBOT_HEIGHT
    centre_x, centre_y = SUBSAMPLES * extent / 2, SUBSAMPLES * extent * height
    cos, sin = scale * math.cos(-turn), scale * math.sin(-turn)
    count = len(bodies)
    for i in range(count):
        dx, dy = bodies[i, 0] - x, bodies[i, 1] - y
        frames[i, 0] = scale * math.cos(bodies[i, 2] - turn)
        frames[i, 1] = scale * math.sin(bodies[i, 2] - turn)
        frames[i, 2] = cos * dx - sin * dy + centre_x
        frames[i, 3] = sin * dx + cos * dy + centre_y
    frames[count, 0], frames[count, 1] = cos, sin
    frames[count, 2] = centre_x - (cos * x - sin * y)
    frames[count, 3] = centre_y - (sin * x + cos * y)


@merged
def render_ground(
    canvas: Canvas,
    corners: Floats,
    colours: Ints,
    background: int,
    workspace: Floats,
    ego: bool,
    whole: bool,
) -> None:
    """Render the background, the workspace and its edge, the regions and their dashes."""
    extent = canvas.size * canvas.samples
    outside = pack(background)
    for pixel in range(canvas.size * canvas.size):
        canvas.ground[pixel] = outside
    polygon, cos, sin = canvas.polygon, workspace[0], workspace[1]
    counter, sides = 0.0, corners.shape[1]
    if ego:
        counter = _counter_left_by_allocentric_frame(corners[len(corners) - 1], whole)
    for i in range(len(corners)):
        for k in range(sides):
            x = cos * corners[i, k, 0] - sin * corners[i, k, 1] + workspace[2]
            y = sin * corners[i, k, 0] + cos * corners[i, k, 1] + workspace[3]
            polygon[CORNER_X, k], polygon[CORNER_Y, k] = x / SUBSAMPLES, y / SUBSAMPLES
            polygon[X, sides - 1 - k], polygon[Y, sides - 1 - k] = rint(x), rint(y)
        polygon[X, sides], polygon[Y, sides] = polygon[X, 0], polygon[Y, 0]
        low, high = scan(polygon, sides, extent, canvas.spans)
        paint(canvas, low, high, colours[i, 0])
        advanced = outline(canvas, colours[i, 1], i > 0, counter, whole)
        counter = advanced if i > 0 else counter


@inlined
def _counter_left_by_allocentric_frame(corners: Floats, whole: bool) -> float:
    """The dash counter after an outline that is entirely in view.

    The published environments render an allocentric frame before every egocentric one.
    """
    pixel = VIEW_WIDTH / RAW_FRAME_SIZE
    width, height = corners[1, 0] - corners[0, 0], corners[0, 1] - corners[3, 1]
    if whole:
        return 2.0 * (round_up(width / pixel) + round_up(height / pixel))
    return 2.0 * float(width + height) / pixel


@merged
def render_bodies(
    canvas: Canvas,
    vertices: Floats,
    items: Ints,
    offsets: Floats,
    frames: Floats,
) -> None:
    """Render blocks and robot, front to back (see `display.DisplayList` for the arrays)."""
    extent = canvas.size * canvas.samples
    for i in range(len(items)):
        first, count, anchor, turn = items[i, 0], items[i, 1], items[i, 2], items[i, 3]
        x, y = offsets[i, 0], offsets[i, 1]
        cos, sin = frames[turn, 0], frames[turn, 1]
        x0 = frames[anchor, 0] * x - frames[anchor, 1] * y + frames[anchor, 2]
        y0 = frames[anchor, 1] * x + frames[anchor, 0] * y + frames[anchor, 3]
        place(vertices, first, count, cos, sin, x0, y0, canvas.polygon)
        low, high = scan(canvas.polygon, count, extent, canvas.spans)
        cover(canvas, low, high, items[i, 4])


@merged
def within_reach(bodies: Floats) -> bool:
    """Whether all poses are finite and within `FURTHEST`."""
    good = True
    for i in range(len(bodies)):
        for k in range(3):
            good &= abs(bodies[i, k]) <= FURTHEST
    return good


@inlined
def _copy(source: Pixels, target: Pixels) -> None:
    for pixel in range(len(target)):
        target[pixel] = source[pixel]


@cache
def compiled_render(samples: int) -> Callable[..., int]:
    """The entry point for samples x samples samples per pixel (1, 2 or 4 across)."""

    @nogil_entry_point
    def render(
        bodies: Floats,
        vertices: Floats,
        items: Ints,
        offsets: Floats,
        corners: Floats,
        colours: Ints,
        ground: Pixels,
        pixels: Pixels,
        kept: Pixels,
        tiles: Ints,
        owners: Pixels,
        counts: Ints,
        body_pixels: Ints,
        touched: Ints,
        polygon: Floats,
        spans: Ints,
        coverage: Pixels,
        frames: Floats,
        size: int,
        mode: int,
        whole: bool,
    ) -> int:
        """Render into `pixels`; returns the number of tiles, or -1 for poses out of range.

        `mode` is one of those above, `whole` is for `lines.outline`; the other arrays are those of
        `display.DisplayList` and `canvas.Canvas`.
        """
        if not within_reach(bodies):
            return -1
        extent, count, counts[0] = size * samples, len(bodies), 0
        memory = tiles, owners, counts, body_pixels, touched, polygon, spans, coverage
        canvas = Canvas(size, samples, ground, pixels, *memory)
        body_frames(bodies, mode == EGO, extent, frames)
        if mode != ALLO:
            workspace, ego = frames[count], mode == EGO
            render_ground(canvas, corners, colours, BACKGROUND, workspace, ego, whole)
        if mode != EGO:
            _copy(ground if mode == GROUND else kept, pixels)
        if mode != GROUND:
            render_bodies(canvas, vertices, items, offsets, frames)
            finish_bodies(canvas)
        finish_ground(canvas)
        return integer(counts[0])

    return render
