"""Outlines of blocks and robot, transforms, and exact overlap tests between convex pieces.

A shape is a list of convex `Piece`s: polygons (counter-clockwise vertices) grown by a radius, or
discs (one vertex grown by a radius). Source: docs/specification.md, sections 2, 3, 4 and 8.
"""

import math
from collections.abc import Iterable
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from magical.scene import constants as c
from magical.scene.scene import Pose
from magical.scene.vocabulary import Shape

Point = tuple[float, float]
Polygon = tuple[Point, ...]


class Piece(NamedTuple):
    """A convex polygon, or a point, grown by `radius`."""

    vertices: Polygon
    radius: float = 0.0


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
def block_pieces(shape: Shape) -> tuple[Piece, ...]:
    """Convex pieces of a block for collisions, in its own frame."""
    if shape == Shape.CIRCLE:
        return (Piece(((0.0, 0.0),), c.BLOCK_SIZE),)
    outline = block_outline(shape)
    if shape == Shape.SQUARE:
        return (Piece(outline, c.SQUARE_MARGIN),)
    if shape == Shape.PENTAGON:
        return (Piece(outline),)
    kites = [(outline[i - 1], outline[i], outline[i + 1], (0.0, 0.0)) for i in range(0, 10, 2)]
    return tuple(Piece(kite) for kite in kites)


@cache
def robot_pieces() -> tuple[Piece, ...]:
    """Convex pieces of the robot with open fingers, in its own frame."""
    pieces = [Piece(((0.0, 0.0),), c.ROBOT_RADIUS)]
    for side in c.SIDES:
        finger = Pose(side * c.FINGER_ROOT_X, c.FINGER_ROOT_Y, -side * c.FINGER_OPEN)
        pieces += place((Piece(polygon) for polygon in finger_polygons(side)), finger)
    return tuple(pieces)


def place(pieces: Iterable[Piece], pose: Pose) -> tuple[Piece, ...]:
    """Pieces given in a body's frame, in workspace coordinates."""
    x0, y0, angle = pose
    cos, sin = math.cos(angle), math.sin(angle)
    return tuple(
        Piece(
            tuple((x0 + (cos * x - sin * y), y0 + (sin * x + cos * y)) for x, y in piece.vertices),
            piece.radius,
        )
        for piece in pieces
    )


def depth(a: Piece, b: Piece) -> float:
    """How far two pieces overlap along the best separating direction; negative when apart.

    The separating axis test over edge normals and, if a piece is rounded, vertex pairs.
    """
    return min(_depths(a, b))


def penetrates(a: Piece, b: Piece) -> bool:
    """Whether `depth(a, b) > 0`; stops at the first direction that separates the two."""
    return all(along > 0.0 for along in _depths(a, b))


def _depths(a: Piece, b: Piece) -> Iterable[float]:
    for nx, ny in _axes(a, b):
        a_along = [nx * x + ny * y for x, y in a.vertices]
        b_along = [nx * x + ny * y for x, y in b.vertices]
        gap = max(min(b_along) - max(a_along), min(a_along) - max(b_along))
        yield a.radius + b.radius - gap


def _axes(a: Piece, b: Piece) -> Iterable[Point]:
    for piece in (a, b):
        count = len(piece.vertices)
        for i in range(count if count > 1 else 0):
            (x0, y0), (x1, y1) = piece.vertices[i], piece.vertices[(i + 1) % count]
            yield _unit(y1 - y0, x0 - x1)
    if a.radius or b.radius:
        for ax, ay in a.vertices:
            for bx, by in b.vertices:
                yield _unit(bx - ax, by - ay)


def _unit(x: float, y: float) -> Point:
    length = math.hypot(x, y)
    if not length:  # of two vertices in one place; every direction bounds the overlap
        return 1.0, 0.0
    return x / length, y / length
