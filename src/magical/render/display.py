"""What there is to draw, as arrays: made once for a scene, placed anew by every frame.

Source of all sizes: details.md, sections 2, 3 and 6.
"""

import math
from collections.abc import Iterable, Iterator
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from magical.render.palette import (
    GREY,
    GREY_OUTLINE,
    OUTSIDE,
    PUPIL,
    RGB,
    SHADES,
    WHITE,
    lanes,
)
from magical.scene import constants as c
from magical.scene.geometry import (
    Point,
    Polygon,
    block_outline,
    finger_polygons,
    rectangle,
    regular_polygon,
    shift,
    star_polygon,
)
from magical.scene.poses import EYES, FINGERS, FIRST_BLOCK, ROBOT
from magical.scene.scene import Block, Region, Scene
from magical.scene.vocabulary import Shape

BLOCK_INSET = 0.015  # units: width of a block's outline
ROBOT_INSET = 0.01  # units: width of the robot's outline
FINGER_INSET = 0.02  # units: the inner finger's lengths and thickness are less by this
EYE_RADIUS = 0.2 * c.ROBOT_RADIUS
EYE_X, EYE_Y = 0.4 * c.ROBOT_RADIUS, 0.3 * c.ROBOT_RADIUS  # x times the side
PUPIL_RADIUS = 0.12 * c.ROBOT_RADIUS
PUPIL_AHEAD = 0.07 * c.ROBOT_RADIUS  # ahead of the eye's centre
DISC_SIDES, EYE_SIDES, PUPIL_SIDES = 100, 20, 10  # discs are drawn as polygons


class Part(NamedTuple):
    """Polygons of one colour on one body.

    They stand at `offset` in the frame of the body in row `anchor` of the poses and turn with the
    body in row `turn`; every polygon is convex and counter-clockwise.
    """

    polygons: tuple[Polygon, ...]
    colour: RGB
    anchor: int
    turn: int
    offset: Point = (0.0, 0.0)


class DisplayList(NamedTuple):
    """A scene's polygons, front to back, and what lies under them."""

    vertices: NDArray[np.float64]  # (2, V): x and y, in their bodies' frames
    items: NDArray[np.int64]  # (n, 5): first vertex, vertices, anchor row, turn row, colour's lanes
    offsets: NDArray[np.float64]  # (n, 2): in the anchor's frame
    ground: NDArray[np.float64]  # (1 + R, 4, 2): workspace and regions, clockwise from top left
    colours: NDArray[np.int64]  # (1 + R, 2): their fill and edge, as lanes


def display_list(scene: Scene) -> DisplayList:
    """Everything of a scene, in the order in which it is drawn (details.md, section 6)."""
    robot = list(_robot_parts())
    blocks = [part for row, block in enumerate(scene.blocks) for part in _block_parts(row, block)]
    parts = [*robot, *blocks] if scene.robot_first else [*blocks, *robot]
    items, offsets, polygons = [], [], []
    first = 0
    for part in reversed(parts):
        for polygon in part.polygons:
            items.append((first, len(polygon), part.anchor, part.turn, lanes(part.colour)))
            offsets.append(part.offset)
            polygons.append(polygon)
            first += len(polygon)
    return DisplayList(
        np.ascontiguousarray(np.concatenate([np.array(polygon) for polygon in polygons]).T),
        np.array(items, np.int64),
        np.array(offsets),
        np.array([_corners(*_WORKSPACE), *(_corners(*_bounds(r)) for r in scene.regions)]),
        np.array(
            [
                (lanes(WHITE), lanes(GREY)),
                *(
                    (lanes(SHADES[r.colour].region), lanes(SHADES[r.colour].fill))
                    for r in scene.regions
                ),
            ],
            np.int64,
        ),
    )


def disc(sides: int, radius: float) -> Polygon:
    """A disc as it is drawn: a regular polygon whose first vertex is on the x axis."""
    turns = (2 * math.pi * i / sides for i in range(sides))
    return tuple((radius * math.cos(turn), radius * math.sin(turn)) for turn in turns)


def fan(star: Polygon) -> tuple[Polygon, ...]:
    """A star as convex kites that meet in its centre, one for each tip."""
    tips = range(0, len(star), 2)
    return tuple(((0.0, 0.0), star[tip - 1], star[tip], star[tip + 1]) for tip in tips)


@cache
def block_shapes(shape: Shape) -> tuple[tuple[Polygon, ...], tuple[Polygon, ...]]:
    """A block's outline and fill as convex polygons, each edge moved inwards for the fill."""
    inset = BLOCK_INSET
    if shape == Shape.CIRCLE:
        return (disc(DISC_SIDES, c.BLOCK_SIZE),), (disc(DISC_SIDES, c.BLOCK_SIZE - inset),)
    if shape == Shape.STAR:
        inner = star_polygon(c.STAR_OUTER_RADIUS - inset, c.STAR_INNER_RADIUS - inset)
        return fan(block_outline(shape)), fan(inner)
    if shape == Shape.SQUARE:
        side = c.SQUARE_SIDE - 2 * inset
        return (block_outline(shape),), (rectangle(side, side),)
    radius = c.PENTAGON_RADIUS - inset / math.cos(math.pi / 5)
    return (block_outline(shape),), (regular_polygon(5, radius),)


def _block_parts(index: int, block: Block) -> Iterator[Part]:
    row = FIRST_BLOCK + index
    outline, fill = block_shapes(block.shape)
    yield Part(outline, SHADES[block.colour].outline, row, row)
    yield Part(fill, SHADES[block.colour].fill, row, row)


def _robot_parts() -> Iterator[Part]:
    fingers = list(zip(c.SIDES, range(FINGERS.start, FINGERS.stop), strict=True))
    for side, row in fingers:
        yield Part(finger_polygons(side), GREY, row, row)
    for side, row in fingers:
        inner = finger_polygons(side, FINGER_INSET)
        yield Part(_moved(inner, 0.0, FINGER_INSET / 2), OUTSIDE, row, row)
    yield Part((disc(DISC_SIDES, c.ROBOT_RADIUS),), GREY_OUTLINE, ROBOT, ROBOT)
    yield Part((disc(DISC_SIDES, c.ROBOT_RADIUS - ROBOT_INSET),), GREY, ROBOT, ROBOT)
    eyes = _moved([disc(EYE_SIDES, EYE_RADIUS)], 0.0, 0.0)
    for side in c.SIDES:
        yield Part(eyes, WHITE, ROBOT, ROBOT, (side * EYE_X, EYE_Y))
    pupil = _moved([disc(PUPIL_SIDES, PUPIL_RADIUS)], 0.0, PUPIL_AHEAD)
    for side, row in zip(c.SIDES, range(EYES.start, EYES.stop), strict=True):
        yield Part(pupil, PUPIL, ROBOT, row, (side * EYE_X, EYE_Y))


def _moved(polygons: Iterable[Polygon], dx: float, dy: float) -> tuple[Polygon, ...]:
    return tuple(shift(polygon, dx, dy) for polygon in polygons)


_WORKSPACE = (-c.WORKSPACE_HALF, c.WORKSPACE_HALF, c.WORKSPACE_HALF, -c.WORKSPACE_HALF)


def _bounds(region: Region) -> tuple[float, float, float, float]:
    x, y = region.x, region.y
    return x, y, x + region.width, y - region.height


def _corners(left: float, top: float, right: float, bottom: float) -> tuple[Point, ...]:
    """Clockwise from the top left: the order in which edges are drawn and dashes counted."""
    return (left, top), (right, top), (right, bottom), (left, bottom)
