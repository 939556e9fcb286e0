"""Outlines of blocks and robot, and transforms (docs/specification.md, sections 2, 3 and 8)."""

import math
from collections.abc import Iterable
from functools import cache

import numpy as np
from numpy.typing import NDArray

from magical.scene import constants as c
from magical.scene.scene import Pose, Shape

Point = tuple[float, float]
Polygon = tuple[Point, ...]


def rotate(point: Point, angle: float) -> Point:
    """The point rotated about the origin, counter-clockwise."""
    cos, sin = math.cos(angle), math.sin(angle)
    return cos * point[0] - sin * point[1], sin * point[0] + cos * point[1]


def to_workspace(point: Point, pose: Pose) -> Point:
    """A point given in a body's frame, in workspace coordinates."""
    x, y = rotate(point, pose.angle)
    return pose.x + x, pose.y + y


def lengths(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Lengths (...) of vectors (..., 2)."""
    return np.sqrt(vectors[..., 0] ** 2 + vectors[..., 1] ** 2)


def rectangle(width: float, height: float) -> Polygon:
    """A rectangle about the origin, counter-clockwise from its top right corner."""
    x, y = width / 2, height / 2
    return (x, y), (-x, y), (-x, -y), (x, -y)


def regular_polygon(count: int, radius: float) -> Polygon:
    """`count` vertices on a circle, counter-clockwise, the first straight up."""
    return tuple(rotate((0.0, radius), 2 * math.pi * i / count) for i in range(count))


def star_polygon(outer: float, inner: float) -> Polygon:
    """A five-pointed star, counter-clockwise, the first outer vertex straight up."""
    return tuple(rotate((0.0, inner if i % 2 else outer), math.pi * i / 5) for i in range(10))


def shift(polygon: Iterable[Point], dx: float, dy: float) -> Polygon:
    """The polygon translated by (dx, dy)."""
    return tuple((x + dx, y + dy) for x, y in polygon)


@cache
def finger_polygons(side: int, shrink: float = 0.0) -> tuple[Polygon, Polygon]:
    """Upper arm and forearm of a finger in its own frame, their dimensions reduced by `shrink`."""
    thickness = c.FINGER_THICKNESS - shrink
    upper_length, fore_length = c.UPPER_ARM_LENGTH - shrink, c.FOREARM_LENGTH - shrink
    upper = shift(rectangle(thickness, upper_length), 0.0, upper_length / 2)
    bend = side * c.FOREARM_BEND
    turned = [rotate(vertex, bend) for vertex in rectangle(thickness, fore_length)]
    elbow_x, elbow_y = rotate((-side * thickness / 2, fore_length / 2), bend)
    # Summed in the order of docs/specification.md, section 2: the last bit matters for gripping.
    centre_x, centre_y = side * thickness / 2 + elbow_x, upper_length / 2 + elbow_y
    return upper, shift(turned, centre_x, centre_y + upper_length / 2)


@cache
def block_outline(shape: Shape) -> Polygon:
    """The polygon of a square, pentagon or star in its own frame (a circle has none)."""
    if shape == Shape.SQUARE:
        return rectangle(c.SQUARE_SIDE, c.SQUARE_SIDE)
    if shape == Shape.PENTAGON:
        return regular_polygon(5, c.PENTAGON_RADIUS)
    if shape == Shape.STAR:
        return star_polygon(c.STAR_OUTER_RADIUS, c.STAR_INNER_RADIUS)
    raise ValueError("a circle has no vertices; use BLOCK_SIZE")


@cache
def robot_polygons() -> tuple[Polygon, ...]:
    """The polygons of both open fingers in the robot's frame."""
    roots = [Pose(s * c.FINGER_ROOT_X, c.FINGER_ROOT_Y, -s * c.FINGER_OPEN) for s in c.SIDES]
    return tuple(
        tuple(to_workspace(vertex, root) for vertex in polygon)
        for side, root in zip(c.SIDES, roots, strict=True)
        for polygon in finger_polygons(side)
    )
