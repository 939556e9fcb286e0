"""The display list: a scene's polygons as arrays, made once and transformed in every frame.

Source of all sizes: docs/specification.md, sections 2, 3 and 6.
"""

import math
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from magical.render.palette import GREY, GREY_OUTLINE, OUTSIDE, PUPIL, RGB, SHADES, WHITE, lanes
from magical.scene import (
    EYES,
    FINGERS,
    FIRST_BLOCK,
    ROBOT,
    Point,
    Polygon,
    Scene,
    Shape,
    block_outline,
    finger_polygons,
    rectangle,
    regular_polygon,
    shift,
    star_polygon,
)
from magical.scene import constants as c

BLOCK_INSET = 0.015  # units: width of a block's outline
ROBOT_INSET = 0.01  # units: width of the robot's outline
FINGER_INSET = 0.02  # units: the inner finger's lengths and thickness are smaller by this
EYE_RADIUS = 0.2 * c.ROBOT_RADIUS
EYE_X, EYE_Y = 0.4 * c.ROBOT_RADIUS, 0.3 * c.ROBOT_RADIUS  # x times the side
PUPIL_RADIUS = 0.12 * c.ROBOT_RADIUS
PUPIL_AHEAD = 0.07 * c.ROBOT_RADIUS  # ahead of the eye's centre
DISC_SIDES, EYE_SIDES, PUPIL_SIDES = 100, 20, 10  # discs are rendered as polygons

Vertices = NDArray[np.float64]  # (2, n): x and y


class Part(NamedTuple):
    """Polygons of one colour on one body.

    They are at `offset` in the frame of the body in row `anchor` of the poses and turn with the
    body in row `turn`; every polygon is convex and counter-clockwise.
    """

    polygons: tuple[Vertices, ...]
    colour: RGB
    anchor: int
    turn: int
    offset: Point = (0.0, 0.0)


class DisplayList(NamedTuple):
    """A scene's polygons, front to back, and what lies under them."""

    vertices: NDArray[np.float64]  # (2, V): x and y, in their bodies' frames
    items: NDArray[np.int64]  # (n, 5): first vertex, vertices, anchor row, turn row, colour's lanes
    offsets: NDArray[np.float64]  # (n, 2): in the anchor's frame
    # The workspace and R regions, clockwise from the top left, as edges are stroked and dashes are
    # counted, (1 + R, 4, 2), and their fill and edge as lanes, (1 + R, 2).
    ground: NDArray[np.float64]
    colours: NDArray[np.int64]


def display_list(scene: Scene) -> DisplayList:
    """All polygons of a scene, in rendering order (docs/specification.md, section 6)."""
    half = c.WORKSPACE_HALF
    sides = [(-half, half, half, -half)]  # left, top, right, bottom
    sides += [(r.x, r.y, r.x + r.width, r.y - r.height) for r in scene.regions]
    ground = [((x, y), (right, y), (right, bottom), (x, bottom)) for x, y, right, bottom in sides]
    shades = [SHADES[region.colour] for region in scene.regions]
    colours = [(WHITE, GREY), *((shade.region, shade.fill) for shade in shades)]
    blocks = []
    for row, block in enumerate(scene.blocks, FIRST_BLOCK):
        (outline, fill), shade = block_shapes(block.shape), SHADES[block.colour]
        blocks += [Part(outline, shade.outline, row, row), Part(fill, shade.fill, row, row)]
    robot = _robot_parts()
    parts = [*robot, *blocks] if scene.robot_first else [*blocks, *robot]
    items, offsets, polygons = [], [], []
    first = 0
    for part in reversed(parts):
        for polygon in part.polygons:
            count = polygon.shape[1]
            items.append((first, count, part.anchor, part.turn, lanes(part.colour)))
            offsets.append(part.offset)
            polygons.append(polygon)
            first += count
    return DisplayList(
        np.concatenate(polygons, axis=1),
        np.array(items, np.int64),
        np.array(offsets),
        np.array(ground),
        np.array([tuple(map(lanes, pair)) for pair in colours], np.int64),
    )


def disc(sides: int, radius: float) -> Polygon:
    """A disc as it is rendered: a regular polygon whose first vertex is on the x axis."""
    turns = (2 * math.pi * i / sides for i in range(sides))
    return tuple((radius * math.cos(turn), radius * math.sin(turn)) for turn in turns)


def convex_parts(star: Polygon) -> tuple[Polygon, ...]:
    """A star with inner radius above 0.382 of the outer as three overlapping convex polygons.

    Tips are the even vertices. A tip and the next but one can see each other, so the two, with the
    four inner vertices next to them, form a convex hexagon; two of these and a kite with the fifth
    tip cover the star.
    """

    def hexagon(tip: int) -> Polygon:
        return tuple(star[(tip + i) % 10] for i in (0, 1, 3, 4, 5, 9))

    return hexagon(0), hexagon(2), (star[8], star[9], (0.0, 0.0), star[7])


@cache
def block_shapes(shape: Shape) -> tuple[tuple[Vertices, ...], tuple[Vertices, ...]]:
    """A block's outline and fill as convex polygons, each edge moved inwards for the fill."""
    inset = BLOCK_INSET
    if shape == Shape.CIRCLE:
        radii = c.BLOCK_SIZE, c.BLOCK_SIZE - inset
        return _vertices(disc(DISC_SIDES, radii[0])), _vertices(disc(DISC_SIDES, radii[1]))
    outline = block_outline(shape)
    if shape == Shape.STAR:
        inner = star_polygon(c.STAR_OUTER_RADIUS - inset, c.STAR_INNER_RADIUS - inset)
        return _vertices(*convex_parts(outline)), _vertices(*convex_parts(inner))
    if shape == Shape.SQUARE:
        side = c.SQUARE_SIDE - 2 * inset
        return _vertices(outline), _vertices(rectangle(side, side))
    radius = c.PENTAGON_RADIUS - inset / math.cos(math.pi / 5)
    return _vertices(outline), _vertices(regular_polygon(5, radius))


def _vertices(*polygons: Polygon) -> tuple[Vertices, ...]:
    return tuple(np.array(polygon).T for polygon in polygons)


@cache
def _robot_parts() -> tuple[Part, ...]:
    parts = []
    fingers = list(zip(c.SIDES, range(FINGERS.start, FINGERS.stop), strict=True))
    for side, row in fingers:
        parts.append(Part(_vertices(*finger_polygons(side)), GREY, row, row))
    for side, row in fingers:
        inner = [shift(p, 0.0, FINGER_INSET / 2) for p in finger_polygons(side, FINGER_INSET)]
        parts.append(Part(_vertices(*inner), OUTSIDE, row, row))
    body, inner_radius = disc(DISC_SIDES, c.ROBOT_RADIUS), c.ROBOT_RADIUS - ROBOT_INSET
    parts.append(Part(_vertices(body), GREY_OUTLINE, ROBOT, ROBOT))
    parts.append(Part(_vertices(disc(DISC_SIDES, inner_radius)), GREY, ROBOT, ROBOT))
    eye = _vertices(disc(EYE_SIDES, EYE_RADIUS))
    parts += [Part(eye, WHITE, ROBOT, ROBOT, (side * EYE_X, EYE_Y)) for side in c.SIDES]
    pupil = _vertices(shift(disc(PUPIL_SIDES, PUPIL_RADIUS), 0.0, PUPIL_AHEAD))
    eyes = zip(c.SIDES, range(EYES.start, EYES.stop), strict=True)
    parts += [Part(pupil, PUPIL, ROBOT, row, (side * EYE_X, EYE_Y)) for side, row in eyes]
    return tuple(parts)
