"""The search for edges in a recorded frame: the compiled part of `edges`.

Polygons are placed on the frame and added, front to back, to the lists of the pixels that they
cover or nearly cover. Then each list explains its pixel's colour. Coordinates are in pixels, x
right and y up from the frame's lower left corner.
"""

import math
from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from magical.compiled import inlined, kernel
from magical.render.display import DISC_SIDES
from magical.render.kernel import GRID as SUBSAMPLES
from magical.render.kernel import VIEW_WIDTH, Floats, Ints
from magical.render.kernel import camera as body_frames
from magical.scene.constants import RAW_FRAME_SIZE as SIZE

SCALE = SIZE / VIEW_WIDTH  # pixels per unit
MAX_LAYERS = 8  # polygons in a pixel's list; further ones are left out
MIXED = 255  # the label of a pixel with none of the scene's plain colours
TILE = 8  # width in pixels, a divisor of SIZE, of the tiles in which edges on the ground are sought
DEEP = 1e3  # pixels: represents any distance beyond the band
DASH_REACH = 3.0  # pixels from a region's edge within which its dashes may lie
AMBIGUOUS = 4.0  # square pixels: explanations whose costs differ by less are rejected

FIRST, COUNT, ANCHOR, TURN, COLOUR, PART = range(6)  # columns of `items`

Labels = NDArray[np.uint8]  # (SIZE, SIZE), lowest row first


class Layers(NamedTuple):
    """A scene's polygons, front to back, and the rectangles on the ground."""

    vertices: Floats  # (2, V)
    items: Ints  # (n, 6): first vertex, vertices, anchor row, turn row, colour, part
    offsets: Floats  # (n, 2): in the anchor's frame
    circles: Floats  # (n, 4): a point inside, radii of the inner and outer circles about it
    rectangles: Floats  # (R + 1, 4): left, right, bottom, top of regions and workspace
    shades: Ints  # (R + 2, 2): colours of their fill and dashes (-1: none); last, the outside


class Near(NamedTuple):
    """The lists of the polygons near each pixel, front to back, up to one that hides the rest."""

    counts: NDArray[np.int8]  # (P,)
    wanted: NDArray[np.bool_]  # (P,): whether an edge of a wanted body is near
    item: NDArray[np.int16]  # (P, MAX_LAYERS)
    edge: NDArray[np.int16]  # (P, MAX_LAYERS): the nearest, a column of `FramePlacement.planes`
    inside: NDArray[np.float32]  # (P, MAX_LAYERS): how far inside that edge the pixel's centre lies


class FramePlacement(NamedTuple):
    """The placement of everything on the frame."""

    frames: Floats  # (bodies + 1, 4): cos, sin (times the scale), x, y; last, the workspace's
    planes: Floats  # (3, V): each edge's outward normal x and y, and its distance along that
    origins: Floats  # (n, 2): of the polygons' own frames
    circles: Floats  # (n, 4): as in `Layers`
    to_workspace: Floats  # (4,): a, b, u, v of (a x + b y + u, a y - b x + v)
    ego: bool


@inlined
def _place_item(layers: Layers, placement: FramePlacement, i: int) -> None:
    """Place one polygon on the frame."""
    item, offset, circle = layers.items[i], layers.offsets[i], layers.circles[i]
    frames, planes, first = placement.frames, placement.planes, item[FIRST]
    vertices = layers.vertices
    anchor, cos, sin = frames[item[ANCHOR]], frames[item[TURN], 0], frames[item[TURN], 1]
    x0 = anchor[0] * offset[0] - anchor[1] * offset[1] + anchor[2]
    y0 = anchor[1] * offset[0] + anchor[0] * offset[1] + anchor[3]
    placement.origins[i, 0], placement.origins[i, 1] = x0, y0
    for k in range(first, first + item[COUNT]):
        following = k + 1 if k + 1 < first + item[COUNT] else first
        dx = vertices[0, following] - vertices[0, k]
        dy = vertices[1, following] - vertices[1, k]
        length = SCALE * math.sqrt(dx * dx + dy * dy)
        nx, ny = (cos * dy + sin * dx) / length, (sin * dy - cos * dx) / length
        x = cos * vertices[0, k] - sin * vertices[1, k] + x0
        y = sin * vertices[0, k] + cos * vertices[1, k] + y0
        planes[0, k], planes[1, k], planes[2, k] = nx, ny, nx * x + ny * y
    placement.circles[i, 0] = cos * circle[0] - sin * circle[1] + x0
    placement.circles[i, 1] = sin * circle[0] + cos * circle[1] + y0
    placement.circles[i, 2] = SCALE * circle[2]
    placement.circles[i, 3] = SCALE * circle[3]


@inlined
def _is_near_wanted(
    items: Ints, circles: Floats, i: int, wanted: NDArray[np.bool_], band: float
) -> bool:
    """Whether a polygon may be near an edge of a wanted body."""
    for k in range(len(items)):
        if wanted[items[k, ANCHOR]] or wanted[items[k, TURN]]:
            dx, dy = circles[i, 0] - circles[k, 0], circles[i, 1] - circles[k, 1]
            reach = circles[i, 3] + circles[k, 3] + 2.0 * band
            if dx * dx + dy * dy < reach * reach:
                return True
    return False


@inlined
def _gather(
    placement: FramePlacement, items: Ints, i: int, near: Near, band: float, wanted: bool
) -> None:
    """Add one polygon to the lists of the pixels that it covers or nearly covers."""
    circle, planes = placement.circles[i], placement.planes
    reach, hollow = circle[3] + band, max(circle[2] - band, 0.0)
    edge = items[i, FIRST]
    for row in range(max(0, int(circle[1] - reach)), min(SIZE, int(circle[1] + reach) + 1)):
        for column in range(max(0, int(circle[0] - reach)), min(SIZE, int(circle[0] + reach) + 1)):
            x, y = column + 0.5, row + 0.5
            square = (x - circle[0]) ** 2 + (y - circle[1]) ** 2
            if square > reach * reach:
                continue
            inside = DEEP
            if square >= hollow * hollow:
                if items[i, COUNT] >= DISC_SIDES:
                    edge = _walk(planes, items[i, FIRST], items[i, COUNT], edge, x, y)
                else:
                    edge = _nearest(planes, items[i, FIRST], items[i, COUNT], x, y)
                inside = planes[2, edge] - planes[0, edge] * x - planes[1, edge] * y
            if inside > -band:
                _add(near, items, row * SIZE + column, i, edge, inside, band)
                near.wanted[row * SIZE + column] |= wanted and inside <= band


@inlined
def _nearest(planes: Floats, first: int, count: int, x: float, y: float) -> int:
    """The edge of a convex polygon that a point lies least far inside, or furthest outside."""
    least, edge = math.inf, first
    for k in range(first, first + count):
        inside = planes[2, k] - planes[0, k] * x - planes[1, k] * y
        if inside < least:
            least, edge = inside, k
    return edge


@inlined
def _walk(planes: Floats, first: int, count: int, edge: int, x: float, y: float) -> int:
    """As `_nearest`, for a regular polygon, searching from an edge that is probably near."""
    least = planes[2, edge] - planes[0, edge] * x - planes[1, edge] * y
    for step in (1, count - 1):
        while True:
            k = first + (edge - first + step) % count
            inside = planes[2, k] - planes[0, k] * x - planes[1, k] * y
            if inside >= least:
                break
            least, edge = inside, k
    return edge


@inlined
def _add(
    near: Near, items: Ints, pixel: int, i: int, edge: int, inside: float, band: float
) -> None:
    """Add a polygon to a pixel's list; of one part's polygons, keep the one it lies deepest in."""
    count = near.counts[pixel]
    if count > 0:
        last = count - 1
        if items[near.item[pixel, last], PART] == items[i, PART]:
            if near.inside[pixel, last] >= inside:
                return
            count = last
        elif near.inside[pixel, last] > band:
            return  # hidden
    if count < MAX_LAYERS:
        near.item[pixel, count], near.edge[pixel, count] = i, edge
        near.inside[pixel, count] = inside
        near.counts[pixel] = count + 1


@inlined
def _depths(
    placement: FramePlacement, rectangles: Floats, x: float, y: float, band: float, ground: Floats
) -> bool:
    """Set `ground` to a point's depths in the rectangles; returns whether it is near an edge."""
    to = placement.to_workspace
    u, v = to[0] * x + to[1] * y + to[2], to[0] * y - to[1] * x + to[3]
    near = False
    for i in range(len(rectangles)):
        across = min(u - rectangles[i, 0], rectangles[i, 1] - u)
        along = min(v - rectangles[i, 2], rectangles[i, 3] - v)
        ground[i] = SCALE * min(across, along)
        near |= abs(ground[i]) <= band
    return near


@inlined
def _explain(
    near: Near,
    pixel: int,
    count: int,
    layers: Layers,
    ground: Floats,
    label: int,
    band: float,
) -> int:
    """The layer that gave a pixel its colour.

    The cost of an explanation is the sum of the squared distances by which edges must move for it.

    Returns:
        An index into the pixel's list, then into `ground`, then the outside; or -1 if no layer,
        more than one layer, or a dash explains the colour.
    """
    items, shades = layers.items, layers.shades
    best = second = math.inf
    chosen, cost = -1, 0.0
    for i in range(count + len(ground)):
        inside = near.inside[pixel, i] if i < count else ground[i - count]
        colour = items[near.item[pixel, i], COLOUR] if i < count else shades[i - count, 0]
        dash = i >= count and label == shades[i - count, 1] and abs(inside) < DASH_REACH
        if dash or (colour == label and inside > -band):
            total = cost if dash or inside > 0.0 else cost + inside * inside
            second = min(max(total, best), second)
            if total < best:
                best, chosen = total, -1 if dash else i
        if inside > band:
            cost = math.inf
            break
        if inside > 0.0:
            cost += inside * inside
    if cost < best and label == shades[len(ground), 0]:
        best, second, chosen = cost, best, count + len(ground)
    return chosen if second - best > min(AMBIGUOUS, band * band) else -1


@inlined
def _place(bodies: Floats, placement: FramePlacement) -> None:
    """Place the bodies on the frame."""
    frames, to = placement.frames, placement.to_workspace
    body_frames(bodies, placement.ego, float(SIZE), frames)
    frames /= SUBSAMPLES
    cos, sin, x, y = frames[len(bodies)]
    square = cos * cos + sin * sin
    to[0], to[1] = cos / square, sin / square
    to[2], to[3] = -to[0] * x - to[1] * y, to[1] * x - to[0] * y


@inlined
def _read_pixels(
    placement: FramePlacement,
    near: Near,
    layers: Layers,
    labels: Labels,
    ground_wanted: bool,
    band: float,
    numbers: NDArray[np.int32],
    margins: Floats,
) -> int:
    """Explain the pixels near wanted edges, tile by tile, and empty their lists."""
    rectangles, rows = layers.rectangles, 0
    ground, room = np.empty(len(rectangles)), len(margins) - MAX_LAYERS - len(rectangles)
    across = SIZE // TILE
    for tile in range(across * across):
        left, bottom = tile % across * TILE, tile // across * TILE
        x, y = left + TILE / 2, bottom + TILE / 2
        on_edge = ground_wanted and _depths(placement, rectangles, x, y, band + TILE, ground)
        for row in range(bottom, bottom + TILE):
            for column in range(left, left + TILE):
                pixel, label = row * SIZE + column, labels[row, column]
                count, asked = near.counts[pixel], near.wanted[pixel]
                near.counts[pixel], near.wanted[pixel] = 0, False
                if label == MIXED or not (asked or on_edge) or rows > room:
                    continue
                x, y = column + 0.5, row + 0.5
                if _depths(placement, rectangles, x, y, band, ground) or asked:
                    layer = _explain(near, pixel, count, layers, ground, label, band)
                    for i in range(min(layer + 1, count + len(ground))):
                        inside = near.inside[pixel, i] if i < count else ground[i - count]
                        if abs(inside) <= band and (placement.ego or i < count):
                            sign = 1 if i == layer else -1
                            margins[rows] = sign * inside
                            numbers[0, rows] = near.item[pixel, i] if i < count else count - i - 1
                            numbers[1, rows] = near.edge[pixel, i] if i < count else 0
                            numbers[2, rows], numbers[3, rows] = pixel, sign
                            rows += 1
    return rows


@cache
def compiled_search() -> Callable[..., int]:
    """The entry point that finds edges."""

    @kernel
    def search(
        bodies: Floats,
        layers: Layers,
        labels: Labels,
        near: Near,
        placement: FramePlacement,
        wanted: NDArray[np.bool_],
        band: float,
        numbers: NDArray[np.int32],
        margins: Floats,
    ) -> int:
        """Write the statements to `numbers` and `margins`; returns how many.

        The rows of `numbers` are the polygon's number, or -1 minus the rectangle's; the edge's
        column in `planes`; the pixel; and 1 or -1 for inside or outside. `placement` is filled in
        too; the counts in `near` are 0 before and after.
        """
        items = layers.items
        _place(bodies, placement)
        for i in range(len(items)):
            _place_item(layers, placement, i)
        all_wanted = placement.ego and wanted[0]  # the camera moves with the robot
        for i in range(len(items)):
            mine = all_wanted or wanted[items[i, ANCHOR]] or wanted[items[i, TURN]]
            if mine or _is_near_wanted(items, placement.circles, i, wanted, band):
                _gather(placement, items, i, near, band, mine)
        return _read_pixels(placement, near, layers, labels, all_wanted, band, numbers, margins)

    return search
