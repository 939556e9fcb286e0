"""Rows of `edges.Edges`: what a pixel's explanation says about the edges near it.

Coordinates are in pixels, x right and y up from the frame's lower left corner.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from magical.render.frame import ROBOT_HEIGHT
from magical.render.jit import inlined
from magical.render.polygons import Floats, Ints

MOST_LAYERS = 8  # polygons in a pixel's list; further ones are left out
FIRST, COUNT, ANCHOR, TURN, COLOUR, PART = range(6)  # columns of `items`


class Near(NamedTuple):
    """The lists of the polygons near each pixel, front to back, up to one that hides the rest."""

    counts: NDArray[np.int8]  # (P,)
    wanted: NDArray[np.bool_]  # (P,): whether an edge of a wanted body is near
    item: NDArray[np.int16]  # (P, MOST_LAYERS)
    edge: NDArray[np.int16]  # (P, MOST_LAYERS): the nearest, a column of `Placement.planes`
    inside: NDArray[np.float32]  # (P, MOST_LAYERS): how far inside that the pixel's centre lies


class Placement(NamedTuple):
    """Where everything is on the frame."""

    frames: Floats  # (bodies + 1, 4): cos, sin (times the scale), x, y; the workspace's last
    planes: Floats  # (3, V): each edge's outward normal x and y, and its distance along that
    origins: Floats  # (n, 2): of the polygons' own frames
    circles: Floats  # (n, 4): as of `edges._Layers`
    to_workspace: Floats  # (4,): a, b, u, v of (a x + b y + u, a y - b x + v)
    scale: float  # pixels a unit
    size: int
    ego: bool


@inlined
def _write_item(
    placement: Placement,
    items: Ints,
    i: int,
    edge: int,
    x: float,
    y: float,
    sign: float,
    values: Floats,
    row: int,
) -> None:
    """The derivatives of `sign` times how far inside a polygon's edge the point lies."""
    nx, ny = sign * placement.planes[0, edge], sign * placement.planes[1, edge]
    anchor = items[i, ANCHOR]
    anchor_x, anchor_y = placement.frames[anchor, 2], placement.frames[anchor, 3]
    own_x, own_y = placement.origins[i, 0], placement.origins[i, 1]
    if anchor == items[i, TURN]:
        own_x, own_y = x, y
    values[3, row] = ny * (own_x - anchor_x) - nx * (own_y - anchor_y)
    values[4, row] = ny * (x - own_x) - nx * (y - own_y)
    _write_camera(placement, nx, ny, x, y, values, row)


@inlined
def _write_ground(
    placement: Placement,
    rectangles: Floats,
    i: int,
    x: float,
    y: float,
    sign: float,
    values: Floats,
    row: int,
) -> None:
    """The same for a rectangle on the ground."""
    to, workspace = placement.to_workspace, len(placement.frames) - 1
    u, v = to[0] * x + to[1] * y + to[2], to[0] * y - to[1] * x + to[3]
    left, right = u - rectangles[i, 0], rectangles[i, 1] - u
    bottom, top = v - rectangles[i, 2], rectangles[i, 3] - v
    nearest = min(left, right, bottom, top)
    nx = -sign if nearest == left else sign if nearest == right else 0.0
    ny = 0.0 if nx != 0.0 else -sign if nearest == bottom else sign
    cos = placement.frames[workspace, 0] / placement.scale
    sin = placement.frames[workspace, 1] / placement.scale
    values[3, row] = values[4, row] = 0.0
    _write_camera(placement, cos * nx - sin * ny, sin * nx + cos * ny, x, y, values, row)


@inlined
def _write_camera(
    placement: Placement, nx: float, ny: float, x: float, y: float, values: Floats, row: int
) -> None:
    """The derivatives by positions in the workspace and by the egocentric camera's angle."""
    workspace = len(placement.frames) - 1
    cos, sin = placement.frames[workspace, 0], placement.frames[workspace, 1]
    values[1, row], values[2, row] = nx * cos + ny * sin, ny * cos - nx * sin
    values[5, row] = 0.0
    if placement.ego:
        centre_x, centre_y = placement.size / 2, placement.size * ROBOT_HEIGHT
        values[5, row] = nx * (y - centre_y) - ny * (x - centre_x)


@inlined
def write_pixel(
    placement: Placement,
    near: Near,
    pixel: int,
    count: int,
    chosen: int,
    items: Ints,
    rectangles: Floats,
    ground: Floats,
    band: float,
    numbers: Ints,
    values: Floats,
    row: int,
) -> int:
    """Write the statements that follow from the layer chosen for a pixel; returns their end."""
    x, y = pixel % placement.size + 0.5, pixel // placement.size + 0.5
    for i in range(min(chosen + 1, count + len(ground))):
        inside = near.inside[pixel, i] if i < count else ground[i - count]
        if abs(inside) > band or (i >= count and not placement.ego):
            continue
        sign = 1.0 if i == chosen else -1.0
        values[0, row] = sign * inside
        if i < count:
            item = near.item[pixel, i]
            numbers[0, row], numbers[1, row] = items[item, ANCHOR], items[item, TURN]
            _write_item(placement, items, item, near.edge[pixel, i], x, y, sign, values, row)
        else:
            numbers[0, row] = numbers[1, row] = -1
            _write_ground(placement, rectangles, i - count, x, y, sign, values, row)
        row += 1
    return row
