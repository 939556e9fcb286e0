"""The components of colours in a frame: pixels of one kind of object that are connected.

A frame is a grid with a border of one pixel on every side, so that every pixel of it has four
neighbours; grids are flat.
"""

import numpy as np
from numpy.typing import NDArray

from magical.compiled import inlined, merged
from magical.render.palette import GREY, RGB, SHADES, WHITE
from magical.scene.constants import FRAME_SIZE
from magical.scene.vocabulary import COLOURS

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Pixels = NDArray[np.uint8]
Grid = NDArray[np.int32]  # (GRID * GRID,)

VIEW_HALF = 1.02  # units: half of what the allocentric camera shows
PIXEL = 2 * VIEW_HALF / FRAME_SIZE  # units

GRID = FRAME_SIZE + 2
NEIGHBOURS = (-GRID, -1, 1, GRID)
NOTHING, BODY, BLOCK, REGION, OPEN = range(5)  # kinds of pixels
AREA, TOP, BOTTOM, LEFT, RIGHT, KIND, COLOUR = range(7)  # of a component, in pixels of the grid


def _code(colour: RGB) -> int:
    return colour[0] | colour[1] << 8 | colour[2] << 16


FILLS, REGIONS = (
    np.array([_code(getattr(SHADES[colour], part)) for colour in COLOURS])
    for part in ("fill", "region")
)
GREY_CODE, WHITE_CODE = _code(GREY), _code(WHITE)
GREY_LEVELS = np.array(GREY)


@inlined
def pixel_x(column: float) -> float:
    """The workspace's x at the centre of a pixel of the frame."""
    return (column + 0.5) * PIXEL - VIEW_HALF


@inlined
def pixel_y(row: float) -> float:
    """The workspace's y at the centre of a pixel of the frame."""
    return VIEW_HALF - (row + 0.5) * PIXEL


@merged
def classify(frame: Pixels, codes: Grid, kinds: Grid, robot_alone: bool) -> None:
    """Each pixel's colour as one integer, and which kind of object has it."""
    for row in range(FRAME_SIZE):
        for column in range(FRAME_SIZE):
            red, green, blue = frame[row, column, 0], frame[row, column, 1], frame[row, column, 2]
            code, at = red | green << 8 | blue << 16, (row + 1) * GRID + column + 1
            kind = BODY if code == GREY_CODE else NOTHING
            if not robot_alone:
                for k in range(len(FILLS)):
                    kind = BLOCK if code == FILLS[k] else kind
                    kind = REGION if code == REGIONS[k] else kind
            codes[at], kinds[at] = code, kind


@inlined
def flood(kinds: Grid, labels: Grid, stack: Grid, start: int, label: int) -> None:
    """Label all pixels of a pixel's kind that are connected with it."""
    kind, depth = kinds[start], 1
    stack[0], labels[start] = start, label
    while depth > 0:
        depth -= 1
        pixel = stack[depth]
        for step in NEIGHBOURS:
            other = pixel + step
            if kinds[other] == kind and labels[other] != label:
                labels[other] = label
                stack[depth] = other
                depth += 1


@merged
def number_components(kinds: Grid, labels: Grid, stack: Grid) -> int:
    """Number the components of each kind in the order of their first pixels; from 1, 0 is none."""
    number = 0
    for pixel in range(GRID * GRID):
        labels[pixel] = 0
    for start in range(GRID * GRID):
        if kinds[start] != NOTHING and labels[start] == 0:
            number += 1
            flood(kinds, labels, stack, start, number)
    return number


@merged
def measure(
    codes: Grid, kinds: Grid, labels: Grid, number: int, parts: Ints, centres: Floats
) -> None:
    """Each component's row of `parts` and its centre."""
    for k in range(number + 1):
        parts[k, AREA] = 0
        parts[k, TOP] = parts[k, LEFT] = GRID
        parts[k, BOTTOM] = parts[k, RIGHT] = 0
        centres[k, 0] = centres[k, 1] = 0.0
    for row in range(FRAME_SIZE):
        for column in range(FRAME_SIZE):
            at = (row + 1) * GRID + column + 1
            k = labels[at]
            if k > 0:
                parts[k, AREA] += 1
                parts[k, TOP], parts[k, BOTTOM] = min(parts[k, TOP], row), row
                parts[k, LEFT] = min(parts[k, LEFT], column)
                parts[k, RIGHT] = max(parts[k, RIGHT], column)
                parts[k, KIND] = kinds[at]
                for colour in range(len(FILLS)):
                    if codes[at] == FILLS[colour] or codes[at] == REGIONS[colour]:
                        parts[k, COLOUR] = colour
                centres[k, 0] += pixel_x(column)
                centres[k, 1] += pixel_y(row)
    for k in range(1, number + 1):
        centres[k, 0] /= parts[k, AREA]
        centres[k, 1] /= parts[k, AREA]
