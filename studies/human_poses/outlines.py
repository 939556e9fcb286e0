"""What the published environments draw, as polygons and colours (docs/specification.md, section 6).

A copy of what the package renders, so that the study does not depend on its renderer's inside.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from magical.scene import (
    EYES,
    FINGERS,
    FIRST_BLOCK,
    ROBOT,
    Block,
    Colour,
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

SIZE = c.RAW_FRAME_SIZE  # pixels across a recorded frame
VIEW_WIDTH = 2.04  # units: the width that both cameras show
ROBOT_HEIGHT = 0.15  # of the frame: the robot's height above its lower edge, in the egocentric view
BLOCK_INSET, ROBOT_INSET, FINGER_INSET = 0.015, 0.01, 0.02  # units: widths of outlines
EYE_RADIUS, PUPIL_RADIUS = 0.2 * c.ROBOT_RADIUS, 0.12 * c.ROBOT_RADIUS
EYE_X, EYE_Y = 0.4 * c.ROBOT_RADIUS, 0.3 * c.ROBOT_RADIUS  # x times the side
PUPIL_AHEAD = 0.07 * c.ROBOT_RADIUS  # ahead of the eye's centre
DISC_SIDES, EYE_SIDES, PUPIL_SIDES = 100, 20, 10  # discs are rendered as polygons
FILL, OUTLINE, REGION = range(3)
SHADES = {
    Colour.RED: ((245, 129, 165), (243, 94, 141), (250, 190, 209)),
    Colour.GREEN: ((195, 208, 130), (183, 198, 105), (224, 231, 191)),
    Colour.BLUE: ((135, 185, 211), (110, 170, 202), (194, 219, 233)),
    Colour.YELLOW: ((254, 213, 123), (254, 201, 86), (254, 234, 188)),
}
GREY, GREY_OUTLINE = (162, 163, 175), (144, 145, 159)  # robot and fingers
OUTSIDE, WHITE, PUPIL = (231, 231, 234), (255, 255, 255), (26, 26, 26)


class Outlines(NamedTuple):
    """A scene's convex polygons, front to back, and the rectangles under them."""

    vertices: NDArray[np.float64]  # (2, V): x and y, in their bodies' frames
    items: NDArray[
        np.int64
    ]  # (n, 4): first vertex, vertices, rows of the body it moves, turns with
    fills: NDArray[np.int64]  # (n, 3)
    offsets: NDArray[np.float64]  # (n, 2): in the frame of the body that it moves with
    ground: NDArray[np.float64]  # (1 + R, 4, 2): corners of the workspace and the regions
    colours: NDArray[np.int64]  # (1 + R, 2, 3): their fill and dashes


def outlines(scene: Scene) -> Outlines:
    """All polygons of a scene, in rendering order."""
    half = c.WORKSPACE_HALF
    areas = [(-half, half, 2 * half, 2 * half)]
    areas += [(r.x, r.y, r.height, r.width) for r in scene.regions]
    ground = [[(x, y), (x + w, y), (x + w, y - h), (x, y - h)] for x, y, h, w in areas]
    shades = [SHADES[region.colour] for region in scene.regions]
    colours = [(WHITE, GREY), *((shade[REGION], shade[FILL]) for shade in shades)]
    blocks = [part for row, block in enumerate(scene.blocks) for part in _block(row, block)]
    parts = [*_robot(), *blocks] if scene.robot_first else [*blocks, *_robot()]
    rows = [(np.array(polygon).T, *rest) for shape, *rest in reversed(parts) for polygon in shape]
    polygons, fills, anchors, turns, offsets = zip(*rows, strict=True)
    counts = [polygon.shape[1] for polygon in polygons]
    first = np.cumsum([0, *counts[:-1]])
    return Outlines(
        np.concatenate(polygons, axis=1),
        np.column_stack([first, counts, anchors, turns]),
        np.array(fills),
        np.array(offsets),
        np.array(ground),
        np.array(colours),
    )


def _disc(sides: int, radius: float) -> Polygon:
    turns = (2 * math.pi * i / sides for i in range(sides))
    return tuple((radius * math.cos(turn), radius * math.sin(turn)) for turn in turns)


def _convex(star: Polygon) -> tuple[Polygon, ...]:
    """A star as three overlapping convex polygons: two hexagons and a kite with the fifth tip."""
    hexagons = (tuple(star[(tip + i) % 10] for i in (0, 1, 3, 4, 5, 9)) for tip in (0, 2))
    return *hexagons, (star[8], star[9], (0.0, 0.0), star[7])


def _block(index: int, block: Block) -> list[Any]:
    inset = BLOCK_INSET
    if block.shape == Shape.CIRCLE:
        shapes = [(_disc(DISC_SIDES, c.BLOCK_SIZE - d),) for d in (0.0, inset)]
    elif block.shape == Shape.STAR:
        radii = c.STAR_OUTER_RADIUS - inset, c.STAR_INNER_RADIUS - inset
        shapes = [_convex(block_outline(block.shape)), _convex(star_polygon(*radii))]
    else:
        side, radius = c.SQUARE_SIDE - 2 * inset, c.PENTAGON_RADIUS - inset / math.cos(math.pi / 5)
        square = block.shape == Shape.SQUARE
        inner = rectangle(side, side) if square else regular_polygon(5, radius)
        shapes = [(block_outline(block.shape),), (inner,)]
    row, shades = FIRST_BLOCK + index, SHADES[block.colour]
    colours = shades[OUTLINE], shades[FILL]
    return [(s, colour, row, row, (0.0, 0.0)) for s, colour in zip(shapes, colours, strict=True)]


def _robot() -> list[Any]:
    here, fingers = (0.0, 0.0), list(zip(c.SIDES, range(3)[FINGERS], strict=True))
    pupil = (tuple(shift(_disc(PUPIL_SIDES, PUPIL_RADIUS), 0.0, PUPIL_AHEAD)),)
    parts: list[Any] = [(finger_polygons(side), GREY, row, row, here) for side, row in fingers]
    for side, row in fingers:
        inner = [shift(p, 0.0, FINGER_INSET / 2) for p in finger_polygons(side, FINGER_INSET)]
        parts.append((inner, OUTSIDE, row, row, here))
    for radius, colour in ((c.ROBOT_RADIUS, GREY_OUTLINE), (c.ROBOT_RADIUS - ROBOT_INSET, GREY)):
        parts.append(((_disc(DISC_SIDES, radius),), colour, ROBOT, ROBOT, here))
    eyes = list(zip(c.SIDES, range(9)[EYES], strict=True))
    for side, _ in eyes:
        eye = (_disc(EYE_SIDES, EYE_RADIUS),)
        parts.append((eye, WHITE, ROBOT, ROBOT, (side * EYE_X, EYE_Y)))
    return parts + [(pupil, PUPIL, ROBOT, row, (side * EYE_X, EYE_Y)) for side, row in eyes]
