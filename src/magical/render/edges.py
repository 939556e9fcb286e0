"""What the pixels of a recorded frame say about the edges of the polygons in it.

Every pixel centre lies inside or outside every polygon. Given roughly known poses and the pixel's
recorded colour, `EdgeFinder` finds the layer that most plausibly gave the colour: the polygons in
front of it must lie beside the pixel centre, and its own polygon must contain it. Each such
statement about a nearby edge is one row of `Edges`: how far it holds, and how that changes with
the bodies' poses.
"""

import math
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from magical.render.display import DisplayList, display_list
from magical.render.frame import ROBOT_HEIGHT, VIEW_WIDTH, body_frames
from magical.render.jit import entry_point, inlined
from magical.render.palette import OUTSIDE, SHADES, WHITE
from magical.render.polygons import SUBSAMPLES, Floats, Ints
from magical.scene.constants import RAW_FRAME_SIZE
from magical.scene.scene import Scene
from magical.scene.vocabulary import View

MIXED = 255  # the label of a pixel of no plain colour: of a smoothed line
LAYERS = 12  # polygons near one pixel; pixels with more are left out
DASH_REACH = 3.0  # pixels from a region's edge within which its dashes may be
AMBIGUOUS = 4.0  # square pixels: explanations that differ by less in cost cancel each other
FAR_INSIDE = 1e3  # pixels: stands for any distance larger than the band

Labels = NDArray[np.uint8]  # (size, size), lowest row first


class Edges(NamedTuple):
    """Statements about edges near pixel centres, one a row.

    `margin` is the pixel centre's distance to the edge, positive where the poses agree with the
    pixel. The gradients are the margin's, in pixels per unit or radian.
    """

    anchor: NDArray[np.int64]  # (N,): row of the body that the polygon stands on; -1: the ground
    turn: NDArray[np.int64]  # (N,): row of the body that it turns with
    margin: NDArray[np.float64]  # (N,): pixels
    position: NDArray[np.float64]  # (N, 2): by the anchor's x and y
    angles: NDArray[np.float64]  # (N, 3): by the anchor's, the turn's and the camera's angle


class EdgeFinder:
    """Finds the edges of one scene's polygons in recorded frames of one view."""

    def __init__(self, scene: Scene, view: View, size: int = RAW_FRAME_SIZE) -> None:
        self.view = view
        self.size = size
        self._palette = _palette(scene)
        self._layers = _layers(display_list(scene), scene, self._palette)
        self._working = _working_memory(size)
        self._find = compiled_find()

    def label(self, frame: NDArray[np.uint8]) -> Labels:
        """The palette index of every pixel's colour, `MIXED` for any other colour."""
        labels = np.empty((self.size, self.size), np.uint8)
        compiled_label()(frame, self._palette, labels)
        return labels

    def find(self, bodies: NDArray[np.float64], labels: Labels, band: float) -> Edges:
        """All statements about edges within `band` pixels of pixel centres, for given poses."""
        ints, floats = self._working[-2:]
        ego = self.view == View.EGO
        count = self._find(bodies, *self._layers, labels, *self._working, band, ego)
        ints, floats = ints[:count].copy(), floats[:count].copy()
        return Edges(ints[:, 0], ints[:, 1], floats[:, 0], floats[:, 1:3], floats[:, 3:6])


class _Layers(NamedTuple):
    """A scene's polygons front to back, and the rectangles on the ground."""

    vertices: Floats  # (2, V)
    items: Ints  # (n, 6): first vertex, vertices, anchor, turn, palette index, part
    offsets: Floats  # (n, 2)
    circles: Floats  # (n, 4): centre x and y, radius of the circle inside, of that around
    rectangles: Floats  # (R + 1, 4): left, right, bottom, top; the uppermost first
    shades: Ints  # (R + 2, 2): palette indices of fill and dashes (-1: none); last, the outside


def _palette(scene: Scene) -> NDArray[np.int32]:
    """The packed colours of everything in the scene, sorted."""
    shown = display_list(scene)
    colours = {_packed_lanes(int(lanes)) for lanes in shown.items[:, 4]}
    colours |= {_packed(rgb) for region in scene.regions for rgb in SHADES[region.colour]}
    return np.array(sorted(colours | {_packed(WHITE), _packed(OUTSIDE)}), np.int32)


def _packed(rgb: tuple[int, int, int]) -> int:
    return rgb[0] | rgb[1] << 8 | rgb[2] << 16


def _packed_lanes(lanes: int) -> int:
    return lanes & 0xFF | lanes >> 8 & 0xFF00 | lanes >> 16 & 0xFF0000


def _layers(shown: DisplayList, scene: Scene, palette: NDArray[np.int32]) -> _Layers:
    def index(packed: int) -> int:
        return int(np.searchsorted(palette, packed))

    items = np.empty((len(shown.items), 6), np.int64)
    items[:, :4] = shown.items[:, :4]
    items[:, 4] = [index(_packed_lanes(int(lanes))) for lanes in shown.items[:, 4]]
    items[:, 5] = _parts(shown)
    shades = [
        (index(_packed(SHADES[r.colour].region)), index(_packed(SHADES[r.colour].fill)))
        for r in reversed(scene.regions)
    ]
    corners = np.concatenate([shown.ground[:0:-1], shown.ground[:1]])
    low, high = corners.min(axis=1), corners.max(axis=1)
    return _Layers(
        shown.vertices,
        items,
        shown.offsets,
        np.array(list(_circles(shown))),
        np.stack([low[:, 0], high[:, 0], low[:, 1], high[:, 1]], axis=1),
        np.array([*shades, (index(_packed(WHITE)), -1), (index(_packed(OUTSIDE)), -1)], np.int64),
    )


def _parts(shown: DisplayList) -> NDArray[np.int64]:
    """Numbers the parts: successive polygons of one colour at one place are one shape."""
    keys = np.concatenate([shown.items[:, 2:], shown.offsets], axis=1)
    return np.concatenate([[0], np.cumsum((keys[1:] != keys[:-1]).any(axis=1))])


def _circles(shown: DisplayList) -> Iterator[tuple[float, float, float, float]]:
    for first, count in shown.items[:, :2].tolist():
        points = shown.vertices[:, first : first + count]
        centre = points.mean(axis=1)
        starts, ends = points, np.roll(points, -1, axis=1)
        dx, dy = ends - starts
        x, y = centre[:, None] - starts
        inner = float(((dx * y - dy * x) / np.hypot(dx, dy)).min())
        outer = float(np.hypot(*(points - centre[:, None])).max())
        yield float(centre[0]), float(centre[1]), inner, outer


@cache
def _working_memory(size: int) -> tuple[Any, ...]:
    """Near polygons of each pixel, then the rows of the result."""
    pixels, rows = size * size, 4 * size * size
    return (
        np.zeros(pixels, np.int64),
        np.empty((pixels, LAYERS), np.int64),
        np.empty((pixels, LAYERS), np.int64),
        np.empty((pixels, LAYERS)),
        np.empty((rows, 2), np.int64),
        np.empty((rows, 6)),
    )


class _Near(NamedTuple):
    """The polygons near each pixel, front to back: which, which edge, how far inside."""

    counts: Ints
    item: Ints
    edge: Ints
    inside: Floats


class _Placement(NamedTuple):
    """Where bodies and polygons are on the frame, in pixels."""

    frames: Floats  # as of `frame.body_frames`: cos, sin, x, y; the workspace's last
    planes: Floats  # (3, V): each edge's outward normal x and y, and its distance along that
    origins: Floats  # (n, 2): of the polygons' own frames
    ego: bool


@cache
def compiled_label() -> Callable[..., None]:
    """The entry point that looks up colours."""

    @entry_point
    def label(frame: Labels, palette: NDArray[np.int32], labels: Labels) -> None:
        size = len(labels)
        last_colour, last_label = -1, MIXED
        for y in range(size):
            row = frame[size - 1 - y]
            for x in range(size):
                colour = np.int64(row[x, 0]) | np.int64(row[x, 1]) << 8 | np.int64(row[x, 2]) << 16
                if colour != last_colour:
                    last_colour, last_label = colour, MIXED
                    for i in range(len(palette)):
                        if palette[i] == colour:
                            last_label = i
                labels[y, x] = last_label

    return label


@inlined
def _place(
    vertices: Floats, items: Ints, offsets: Floats, circles: Floats, placement: _Placement
) -> Floats:
    """Place every polygon on the frame, in pixels, and return the circles around them there."""
    frames, planes = placement.frames, placement.planes
    placed = np.empty((len(items), 4))
    for i in range(len(items)):
        first, count, anchor, turn = items[i, 0], items[i, 1], items[i, 2], items[i, 3]
        x, y = offsets[i, 0], offsets[i, 1]
        cos, sin = frames[turn, 0], frames[turn, 1]
        x0 = frames[anchor, 0] * x - frames[anchor, 1] * y + frames[anchor, 2]
        y0 = frames[anchor, 1] * x + frames[anchor, 0] * y + frames[anchor, 3]
        placement.origins[i, 0], placement.origins[i, 1] = x0, y0
        for k in range(first, first + count):
            following = k + 1 if k + 1 < first + count else first
            dx = vertices[0, following] - vertices[0, k]
            dy = vertices[1, following] - vertices[1, k]
            length = math.sqrt((dx * dx + dy * dy) * (cos * cos + sin * sin))
            nx, ny = (cos * dy + sin * dx) / length, (sin * dy - cos * dx) / length
            px = cos * vertices[0, k] - sin * vertices[1, k] + x0
            py = sin * vertices[0, k] + cos * vertices[1, k] + y0
            planes[0, k], planes[1, k], planes[2, k] = nx, ny, nx * px + ny * py
        scale = math.sqrt(cos * cos + sin * sin)
        placed[i, 0] = cos * circles[i, 0] - sin * circles[i, 1] + x0
        placed[i, 1] = sin * circles[i, 0] + cos * circles[i, 1] + y0
        placed[i, 2], placed[i, 3] = scale * circles[i, 2], scale * circles[i, 3]
    return placed


@inlined
def _gather(
    planes: Floats, items: Ints, i: int, circle: Floats, near: _Near, size: int, band: float
) -> None:
    """Add one polygon to the lists of the pixels that it may cover."""
    reach = circle[3] + band
    for y in range(max(0, int(circle[1] - reach)), min(size, int(circle[1] + reach) + 1)):
        for x in range(max(0, int(circle[0] - reach)), min(size, int(circle[0] + reach) + 1)):
            px, py = x + 0.5, y + 0.5
            square = (px - circle[0]) ** 2 + (py - circle[1]) ** 2
            if square > reach * reach:
                continue
            inside, edge = FAR_INSIDE, -1
            if circle[2] < band or square > (circle[2] - band) ** 2:
                inside, edge = _nearest_edge(planes, items[i, 0], items[i, 1], px, py)
            if inside > -band:
                _add(near, items, y * size + x, i, edge, inside, band)


@inlined
def _nearest_edge(planes: Floats, first: int, count: int, x: float, y: float) -> tuple[float, int]:
    """How far inside a convex polygon a point lies, and by which edge."""
    inside, edge = FAR_INSIDE, -1
    for i in range(first, first + count):
        distance = planes[2, i] - planes[0, i] * x - planes[1, i] * y
        if distance < inside:
            inside, edge = distance, i
    return inside, edge


@inlined
def _add(
    near: _Near, items: Ints, pixel: int, i: int, edge: int, inside: float, band: float
) -> None:
    """Add to a pixel's list; of the polygons of one part, the one that it lies deepest in."""
    count = near.counts[pixel]
    if count > 0:
        last = count - 1
        if items[near.item[pixel, last], 5] == items[i, 5]:
            if near.inside[pixel, last] >= inside:
                return
            count = last
        elif near.inside[pixel, last] > band:
            return  # hidden
    if count == LAYERS:
        return
    near.item[pixel, count], near.edge[pixel, count] = i, edge
    near.inside[pixel, count] = inside
    near.counts[pixel] = count + 1


@inlined
def _explain(
    near: _Near,
    count: int,
    items: Ints,
    pixel: int,
    label: int,
    band: float,
    ground: Floats,
    shades: Ints,
) -> int:
    """Which layer gave a pixel its colour: an index of its list, then of the rectangles.

    Returns:
        -1 where no layer, or more than one, explains the colour.
    """
    rectangles = len(shades) - 1
    best = second = math.inf
    chosen, cost = -1, 0.0
    for i in range(count + rectangles):
        inside = near.inside[pixel, i] if i < count else ground[i - count]
        colour = items[near.item[pixel, i], 4] if i < count else shades[i - count, 0]
        dash = i >= count and abs(inside) < DASH_REACH and label == shades[i - count, 1]
        if dash or (colour == label and inside > -band):
            total = cost if dash or inside > 0.0 else cost + inside * inside
            if total < best:
                best, second, chosen = total, best, i
            else:
                second = min(second, total)
            if dash:
                chosen = -1
        if inside > band:
            cost = math.inf
            break
        if inside > 0.0:
            cost += inside * inside
    if cost < best and label == shades[rectangles, 0]:
        best, second, chosen = cost, best, count + rectangles
    return chosen if second - best > min(AMBIGUOUS, band * band) else -1


@inlined
def _to_workspace(workspace: Floats, to: Floats) -> None:
    """The map from the frame to the workspace, (a, b, u0, v0): u = a x + b y + u0, v likewise."""
    square = workspace[0] * workspace[0] + workspace[1] * workspace[1]
    to[0], to[1] = workspace[0] / square, workspace[1] / square
    to[2] = -to[0] * workspace[2] - to[1] * workspace[3]
    to[3] = to[1] * workspace[2] - to[0] * workspace[3]


@inlined
def _depths(
    rectangles: Floats, to: Floats, scale: float, x: float, y: float, band: float, ground: Floats
) -> bool:
    """How far inside the rectangles a point of the frame lies, in pixels; if near any edge."""
    u, v = to[0] * x + to[1] * y + to[2], to[0] * y - to[1] * x + to[3]
    near = False
    for i in range(len(rectangles)):
        across = min(u - rectangles[i, 0], rectangles[i, 1] - u)
        ground[i] = scale * min(across, v - rectangles[i, 2], rectangles[i, 3] - v)
        near |= abs(ground[i]) <= band
    return near


@inlined
def _normal(
    rectangle: Floats, workspace: Floats, to: Floats, x: float, y: float
) -> tuple[float, float]:
    """The outward normal, on the frame, of a rectangle's edge nearest to a point of the frame."""
    u, v = to[0] * x + to[1] * y + to[2], to[0] * y - to[1] * x + to[3]
    left, right = u - rectangle[0], rectangle[1] - u
    bottom, top = v - rectangle[2], rectangle[3] - v
    nearest = min(left, right, bottom, top)
    nx = -1.0 if nearest == left else 1.0 if nearest == right else 0.0
    ny = 0.0 if nx != 0.0 else -1.0 if nearest == bottom else 1.0
    scale = math.sqrt(workspace[0] * workspace[0] + workspace[1] * workspace[1])
    cos, sin = workspace[0] / scale, workspace[1] / scale
    return cos * nx - sin * ny, sin * nx + cos * ny


@inlined
def _item_gradient(
    placement: _Placement,
    items: Ints,
    item: int,
    edge: int,
    x: float,
    y: float,
    size: int,
    sign: float,
    row: Floats,
) -> None:
    """The gradient of `sign` times how far inside a polygon's edge the point (x, y) lies."""
    nx, ny = sign * placement.planes[0, edge], sign * placement.planes[1, edge]
    anchor, turn = items[item, 2], items[item, 3]
    anchor_x, anchor_y = placement.frames[anchor, 2], placement.frames[anchor, 3]
    own_x, own_y = placement.origins[item, 0], placement.origins[item, 1]
    if anchor == turn:
        own_x, own_y = x, y
    row[3] = ny * (own_x - anchor_x) - nx * (own_y - anchor_y)
    row[4] = ny * (x - own_x) - nx * (y - own_y)
    _camera_gradient(placement, nx, ny, x, y, size, row)


@inlined
def _ground_gradient(
    placement: _Placement,
    rectangle: Floats,
    to: Floats,
    x: float,
    y: float,
    size: int,
    sign: float,
    row: Floats,
) -> None:
    """The same for a rectangle on the ground."""
    nx, ny = _normal(rectangle, placement.frames[len(placement.frames) - 1], to, x, y)
    row[3] = row[4] = 0.0
    _camera_gradient(placement, sign * nx, sign * ny, x, y, size, row)


@inlined
def _camera_gradient(
    placement: _Placement, nx: float, ny: float, x: float, y: float, size: int, row: Floats
) -> None:
    """By positions in the workspace, and by the angle of the egocentric camera."""
    workspace = placement.frames[len(placement.frames) - 1]
    row[1] = nx * workspace[0] + ny * workspace[1]
    row[2] = ny * workspace[0] - nx * workspace[1]
    row[5] = 0.0
    if placement.ego:
        row[5] = nx * (y - size * ROBOT_HEIGHT) - ny * (x - size / 2)


@cache
def compiled_find() -> Callable[..., int]:
    """The entry point that finds edges."""

    @entry_point
    def find(
        bodies: Floats,
        vertices: Floats,
        items: Ints,
        offsets: Floats,
        circles: Floats,
        rectangles: Floats,
        shades: Ints,
        labels: Labels,
        counts: Ints,
        near_item: Ints,
        near_edge: Ints,
        near_inside: Floats,
        ints: Ints,
        floats: Floats,
        band: float,
        ego: bool,
    ) -> int:
        """Write the rows of `Edges` to `ints` and `floats`; returns their number."""
        size, rows = len(labels), 0
        near = _Near(counts, near_item, near_edge, near_inside)
        frames = np.empty((len(bodies) + 1, 4))
        body_frames(bodies, ego, float(size), frames)
        frames /= SUBSAMPLES
        placement = _Placement(frames, np.empty((3, vertices.shape[1])), np.empty((len(items), 2)), ego)
        circles = _place(vertices, items, offsets, circles, placement)
        ground, to, workspace = np.empty(len(rectangles)), np.empty(4), frames[len(bodies)]
        _to_workspace(workspace, to)
        scale = math.sqrt(workspace[0] * workspace[0] + workspace[1] * workspace[1])
        for i in range(len(items)):
            _gather(placement.planes, items, i, circles[i], near, size, band)
        for pixel in range(size * size):
            label, count = labels[pixel // size, pixel % size], counts[pixel]
            counts[pixel] = 0
            if label == MIXED or (count == 0 and not ego):
                continue
            x, y = pixel % size + 0.5, pixel // size + 0.5
            near_ground = _depths(rectangles, to, scale, x, y, band, ground)
            if count == 0 and not near_ground:
                continue
            chosen = _explain(near, count, items, pixel, label, band, ground, shades)
            if chosen < 0 or rows + count + len(ground) > len(ints):
                continue
            for i in range(min(chosen + 1, count + len(ground))):
                inside = near_inside[pixel, i] if i < count else ground[i - count]
                if abs(inside) <= band and (ego or i < count):
                    sign = 1.0 if i == chosen else -1.0
                    floats[rows, 0] = sign * inside
                    if i < count:
                        item = near_item[pixel, i]
                        ints[rows, 0], ints[rows, 1] = items[item, 2], items[item, 3]
                        _item_gradient(placement, items, item, near_edge[pixel, i], x, y, size, sign, floats[rows])
                    else:
                        ints[rows, 0] = ints[rows, 1] = -1
                        _ground_gradient(placement, rectangles[i - count], to, x, y, size, sign, floats[rows])
                    rows += 1
        return rows

    return find
