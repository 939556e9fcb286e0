"""Evidence about the edges of polygons, from the pixels of a recorded frame.

Every pixel centre lies inside or outside every polygon. Given approximate poses and a pixel's
recorded colour, `EdgeFinder` finds the layer that most plausibly gave the colour: the pixel's
centre must lie inside this layer's polygon and outside all polygons in front of it. Each such
statement about a nearby edge is one row of `Edges`: by how much the poses satisfy it, and how that
changes with the bodies' poses.

Coordinates are in pixels, x right and y up from the frame's lower left corner.
"""

import math
from functools import cache
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray
from outlines import (
    DISC_SIDES,
    OUTSIDE,
    ROBOT_HEIGHT,
    SIZE,
    VIEW_WIDTH,
    WHITE,
    Outlines,
    outlines,
)

from magical.scene import Scene, View

SCALE = SIZE / VIEW_WIDTH  # pixels per unit
MAX_LAYERS = 8  # polygons in a pixel's list; further ones are left out
MIXED = 255  # the label of a pixel with none of the scene's plain colours
TILE = 8  # width in pixels, a divisor of SIZE, of the tiles in which edges on the ground are sought
DEEP = 1e3  # pixels: represents any distance beyond the band
DASH_REACH = 3.0  # pixels from a region's edge within which its dashes may lie
AMBIGUOUS = 4.0  # square pixels: explanations whose costs differ by less are rejected

FIRST, COUNT, ANCHOR, TURN, COLOUR, PART = range(6)  # columns of `items`

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
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


@njit
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


@njit
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


@njit
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


@njit
def _nearest(planes: Floats, first: int, count: int, x: float, y: float) -> int:
    """The edge of a convex polygon that a point lies least far inside, or furthest outside."""
    least, edge = math.inf, first
    for k in range(first, first + count):
        inside = planes[2, k] - planes[0, k] * x - planes[1, k] * y
        if inside < least:
            least, edge = inside, k
    return edge


@njit
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


@njit
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


@njit
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


@njit
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


@njit
def _place(bodies: Floats, placement: FramePlacement) -> None:
    """Place the bodies on the frame, as seen by the camera."""
    frames, to, count = placement.frames, placement.to_workspace, len(bodies)
    x, y, turn, height = 0.0, 0.0, 0.0, 0.5  # the camera's pose, and its height in the frame
    if placement.ego:
        x, y, turn, height = bodies[0, 0], bodies[0, 1], bodies[0, 2], ROBOT_HEIGHT
    cos, sin = SCALE * math.cos(-turn), SCALE * math.sin(-turn)
    for i in range(count + 1):  # the last is the workspace
        dx, dy, angle = -x, -y, 0.0
        if i < count:
            dx, dy, angle = bodies[i, 0] - x, bodies[i, 1] - y, bodies[i, 2]
        frames[i, 0] = SCALE * math.cos(angle - turn)
        frames[i, 1] = SCALE * math.sin(angle - turn)
        frames[i, 2] = cos * dx - sin * dy + SIZE / 2
        frames[i, 3] = sin * dx + cos * dy + SIZE * height
    cos, sin, x, y = frames[count]
    square = cos * cos + sin * sin
    to[0], to[1] = cos / square, sin / square
    to[2], to[3] = -to[0] * x - to[1] * y, to[1] * x - to[0] * y


@njit
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


@njit(cache=True)
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

    Rows of `numbers`: the polygon, or -1 minus the rectangle; the edge, a column of `planes`; the
    pixel; 1 or -1 for inside or outside.
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


class Edges(NamedTuple):
    """N statements about edges near pixel centres: margins, and how they change with poses."""

    anchor: NDArray[np.int64]  # (N,): row of the body that the polygon moves with; -1: the ground
    turn: NDArray[np.int64]  # (N,): row of the body that it turns with; -1: the ground
    margin: NDArray[np.float64]  # (N,): pixels from the edge, positive if it is satisfied
    x: NDArray[np.float64]  # (N,): with respect to the anchor's x, or to minus the camera's
    y: NDArray[np.float64]  # (N,): the same for y
    anchor_angle: NDArray[np.float64]  # (N,)
    turn_angle: NDArray[np.float64]  # (N,): 0 if the polygon turns with its anchor
    camera_angle: NDArray[np.float64]  # (N,): by the camera's angle; 0 in allocentric frames


class EdgeFinder:
    """Finds edges in recorded frames of one scene and view, with one sample per pixel."""

    def __init__(self, scene: Scene, view: View) -> None:
        self._is_ego = view == View.EGO
        self._palette, self._layers = _layers(outlines(scene))

    def label(self, frame: NDArray[np.uint8]) -> Labels:
        """Numbers of every pixel's colour, `MIXED` for any but the scene's; lowest row first."""
        packed = frame[::-1].astype(np.int32) @ np.array([1, 1 << 8, 1 << 16], np.int32)
        numbers = np.searchsorted(self._palette, packed)
        known = self._palette.take(numbers, mode="clip") == packed
        return np.where(known, numbers, MIXED).astype(np.uint8)

    def find(
        self, bodies: NDArray[np.float64], labels: Labels, band: float, wanted: NDArray[np.bool_]
    ) -> Edges:
        """All statements about edges within `band` pixels of pixel centres."""
        near, numbers, margins = _working_memory()
        placement = FramePlacement(
            frames=np.empty((len(bodies) + 1, 4)),
            planes=np.empty((3, self._layers.vertices.shape[1])),
            origins=np.empty((len(self._layers.items), 2)),
            circles=np.empty_like(self._layers.circles),
            to_workspace=np.empty(4),
            ego=self._is_ego,
        )
        count = search(
            bodies, self._layers, labels, near, placement, wanted, band, numbers, margins
        )
        return self._edges(numbers[:, :count], margins[:count].copy(), placement)

    def _edges(
        self, numbers: NDArray[np.int32], margins: Floats, placement: FramePlacement
    ) -> Edges:
        """The statements found by `search`, with their derivatives."""
        item, edge, pixel, sign = numbers
        frames, planes, origins = placement.frames, placement.planes, placement.origins
        x, y = pixel % SIZE + 0.5, pixel // SIZE + 0.5
        ground, workspace = item < 0, frames[-1]
        nx, ny = planes[0, edge], planes[1, edge]
        nx[ground], ny[ground] = self._ground_normals(
            -1 - item[ground], x[ground], y[ground], workspace
        )
        nx, ny = sign * nx, sign * ny
        polygon = np.where(ground, 0, item)
        anchor = np.where(ground, -1, self._layers.items[polygon, ANCHOR])
        turn = np.where(ground, -1, self._layers.items[polygon, TURN])
        own_x, own_y = np.where(anchor == turn, (x, y), origins[polygon].T)
        anchor_x, anchor_y = frames[anchor, 2:].T
        camera = np.zeros_like(margins)
        if self._is_ego:
            camera = nx * (y - SIZE * ROBOT_HEIGHT) - ny * (x - SIZE / 2)
        return Edges(
            *(anchor, turn, margins),
            x=nx * workspace[0] + ny * workspace[1],
            y=ny * workspace[0] - nx * workspace[1],
            anchor_angle=ny * (own_x - anchor_x) - nx * (own_y - anchor_y),
            turn_angle=ny * (x - own_x) - nx * (y - own_y),
            camera_angle=camera,
        )

    def _ground_normals(
        self, rectangle: NDArray[np.int32], x: Floats, y: Floats, workspace: Floats
    ) -> tuple[Floats, Floats]:
        """The outward normals, on the frame, of the rectangle edges nearest to the points."""
        cos, sin, x0, y0 = workspace
        square, dx, dy = cos * cos + sin * sin, x - x0, y - y0
        u, v = (cos * dx + sin * dy) / square, (cos * dy - sin * dx) / square
        left, right, bottom, top = self._layers.rectangles[rectangle].T
        nearest = np.argmin([u - left, right - u, v - bottom, top - v], axis=0)
        outward = np.array([(-1.0, 0.0), (1.0, 0.0), (0.0, -1.0), (0.0, 1.0)])[nearest]
        nx, ny = outward.T / np.sqrt(square)
        return cos * nx - sin * ny, sin * nx + cos * ny


def _layers(shown: Outlines) -> tuple[NDArray[np.int32], Layers]:
    """The packed colours in a scene, in ascending order, and its layers."""
    count, regions = len(shown.items), shown.colours[:0:-1].reshape(-1, 3)  # uppermost first
    colours = np.concatenate([shown.fills, regions, [WHITE, OUTSIDE]]).astype(np.int64)
    palette, numbers = np.unique(colours @ [1, 1 << 8, 1 << 16], return_inverse=True)
    keys = np.concatenate([shown.items[:, 2:], numbers[:count, None], shown.offsets], axis=1)
    # Successive polygons of one colour in one place form one shape.
    parts = np.cumsum([0, *(keys[1:] != keys[:-1]).any(axis=1)])
    items = np.column_stack([shown.items, numbers[:count], parts])
    shades = [*numbers[count:-2].reshape(-1, 2), *((number, -1) for number in numbers[-2:])]
    corners = np.concatenate([shown.ground[:0:-1], shown.ground[:1]])
    low, high = corners.min(axis=1), corners.max(axis=1)
    rectangles = np.stack([low[:, 0], high[:, 0], low[:, 1], high[:, 1]], axis=1)
    circles = np.array([_circles(shown.vertices[:, a : a + n]) for a, n in items[:, :2]])
    return palette.astype(np.int32), Layers(
        shown.vertices, items, shown.offsets, circles, rectangles, np.array(shades, np.int64)
    )


def _circles(points: Floats) -> tuple[float, float, float, float]:
    """A polygon's centre, and the radii of the inner and outer circles about it."""
    centre = points.mean(axis=1, keepdims=True)
    dx, dy = np.roll(points, -1, axis=1) - points
    x, y = centre - points
    inner = float(((dx * y - dy * x) / np.hypot(dx, dy)).min())
    return float(centre[0, 0]), float(centre[1, 0]), inner, float(np.hypot(x, y).max())


@cache
def _working_memory() -> tuple[Near, NDArray[np.int32], Floats]:
    """Scratch and result arrays of `search`."""
    pixels, rows = SIZE * SIZE, 4 * SIZE * SIZE
    near = Near(
        counts=np.zeros(pixels, np.int8),
        wanted=np.zeros(pixels, np.bool_),
        item=np.empty((pixels, MAX_LAYERS), np.int16),
        edge=np.empty((pixels, MAX_LAYERS), np.int16),
        inside=np.empty((pixels, MAX_LAYERS), np.float32),
    )
    return near, np.empty((4, rows), np.int32), np.empty(rows)
