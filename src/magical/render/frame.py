"""A whole frame: cameras, ground, bodies, and the compiled entry point."""

import math
from collections.abc import Callable
from functools import cache

import numpy as np
from numpy.typing import NDArray

from magical.compiled import entry_point, inlined, merged
from magical.render.canvas import Canvas, cover, finish_bodies, finish_ground, pack, paint
from magical.render.display import FURTHEST
from magical.render.lines import outline, round_up
from magical.render.palette import OUTSIDE, lanes
from magical.render.polygons import MAX_SIDES, SUBSAMPLES, Floats, Ints, place, scan
from magical.scene.constants import RAW_FRAME_SIZE

VIEW_WIDTH = 2.04  # units: both cameras show as much (docs/specification.md, section 6)
ROBOT_HEIGHT = 0.15  # of the frame: where the egocentric camera has the robot, from below
EGO, GROUND, ALLO = 0, 1, 2  # modes of the compiled `render`
BACKGROUND = lanes(OUTSIDE)

Pixels = NDArray[np.int32]


@merged
def body_frames(bodies: Floats, ego: bool, extent: float, frames: Floats) -> None:
    """Every body's frame on the grid, the workspace's last: cos, sin (times the scale), x, y."""
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
    edges: Floats,
    spans: Ints,
) -> None:
    """Background, workspace and its edge, regions and their dashes."""
    extent = canvas.size * canvas.samples
    outside = pack(background)
    for pixel in range(canvas.size * canvas.size):
        canvas.ground[pixel] = outside
    turned, placed, on_frame = np.empty((2, 4)), np.empty((2, 5)), np.empty((4, 2))
    counter, sides = 0.0, corners.shape[1]
    if ego:
        counter = _counter_left_by_allocentric_frame(corners[len(corners) - 1], whole)
    for i in range(len(corners)):
        for k in range(sides):
            x, y = corners[i, k, 0], corners[i, k, 1]
            turned[0, sides - 1 - k], turned[1, sides - 1 - k] = x, y
            on_frame[k, 0] = (workspace[0] * x - workspace[1] * y + workspace[2]) / SUBSAMPLES
            on_frame[k, 1] = (workspace[1] * x + workspace[0] * y + workspace[3]) / SUBSAMPLES
        place(turned, 0, sides, workspace, placed)
        low, high = scan(placed, sides, extent, extent, edges, spans)
        paint(canvas, spans, low, high, colours[i, 0])
        advanced = outline(canvas, on_frame, colours[i, 1], i > 0, counter, whole)
        counter = advanced if i > 0 else counter


@inlined
def _counter_left_by_allocentric_frame(corners: Floats, whole: bool) -> float:
    """Where the dash counter stands after an outline that is all in view.

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
    edges: Floats,
    spans: Ints,
) -> None:
    """Blocks and robot, front to back (see `display.DisplayList` for the arrays)."""
    extent = canvas.size * canvas.samples
    placed, frame = np.empty((2, MAX_SIDES + 1)), np.empty(4)
    for i in range(len(items)):
        first, count, anchor, turn = items[i, 0], items[i, 1], items[i, 2], items[i, 3]
        x, y = offsets[i, 0], offsets[i, 1]
        frame[0], frame[1] = frames[turn, 0], frames[turn, 1]
        frame[2] = frames[anchor, 0] * x - frames[anchor, 1] * y + frames[anchor, 2]
        frame[3] = frames[anchor, 1] * x + frames[anchor, 0] * y + frames[anchor, 3]
        place(vertices, first, count, frame, placed)
        low, high = scan(placed, count, extent, extent, edges, spans)
        cover(canvas, spans, low, high, items[i, 4])


@merged
def within_reach(bodies: Floats) -> bool:
    """Whether all poses are finite and within `FURTHEST`."""
    good = True
    for i in range(len(bodies)):
        for k in range(3):
            good &= abs(bodies[i, k]) <= FURTHEST
    return good


@cache
def compiled_render(samples: int) -> Callable[..., int]:
    """The entry point for samples x samples samples a pixel (1, 2 or 4 across)."""

    @entry_point
    def render(
        bodies: Floats,
        vertices: Floats,
        items: Ints,
        offsets: Floats,
        corners: Floats,
        colours: Ints,
        ground: Pixels,
        tiles: Ints,
        owners: Pixels,
        body_pixels: Ints,
        touched: Ints,
        pixels: Pixels,
        kept: Pixels,
        size: int,
        mode: int,
        whole: bool,
    ) -> int:
        """Render into `pixels`; returns the number of tiles, or -1 for poses out of range.

        Mode EGO renders everything; `ground` is the same array as `pixels`. GROUND renders the
        allocentric ground only. ALLO renders bodies over a ground that was rendered before, its
        finished pixels in `kept`. `whole` is for `lines.outline`. The other arrays are those of
        `display.DisplayList` and `canvas.Canvas`.
        """
        if not within_reach(bodies):
            return -1
        extent, count, counts = size * samples, len(bodies), np.zeros(1, np.int64)
        edges, spans = np.empty((3, MAX_SIDES + 1)), np.empty((2, extent + samples), np.int64)
        frames = np.empty((count + 1, 4))
        canvas = Canvas(ground, tiles, owners, counts, body_pixels, touched, pixels, size, samples)
        body_frames(bodies, mode == EGO, extent, frames)
        if mode != ALLO:
            workspace, ego = frames[count], mode == EGO
            render_ground(canvas, corners, colours, BACKGROUND, workspace, ego, whole, edges, spans)
        if mode != EGO:
            source = ground if mode == GROUND else kept
            for pixel in range(size * size):
                pixels[pixel] = source[pixel]
        if mode != GROUND:
            render_bodies(canvas, vertices, items, offsets, frames, edges, spans)
            finish_bodies(canvas)
        finish_ground(canvas)
        return int(counts[0])

    return render
