"""The connected components of a frame: pixels of one kind of object that are connected.

A grid is flat and holds a frame with a border of one pixel on every side, so that each of the
frame's pixels has four neighbours.

Goal regions are the bounding rectangles of each region colour's components. A robot or block on a
region can split it; parts are joined if no empty workspace lies between them.
"""

import numpy as np
from numpy.typing import NDArray

from magical.compiled import inlined
from magical.render.kernel import VIEW_WIDTH
from magical.render.palette import GREY, RGB, SHADES, WHITE
from magical.scene.constants import FRAME_SIZE
from magical.scene.vocabulary import COLOURS

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Pixels = NDArray[np.uint8]
Grid = NDArray[np.int32]  # (GRID * GRID,)

VIEW_HALF = VIEW_WIDTH / 2  # units: half the side of the allocentric camera's view
PIXEL = 2 * VIEW_HALF / FRAME_SIZE  # units

GRID = FRAME_SIZE + 2
NEIGHBOURS = (-GRID, -1, 1, GRID)
NOTHING, BODY, BLOCK, REGION, OPEN = range(5)  # kinds of pixels
AREA, TOP, BOTTOM, LEFT, RIGHT, KIND, COLOUR = range(7)  # columns of `parts`; in frame pixels

MAX_REGIONS = 3  # the most in any of the benchmark's tasks
MIN_REGION_PIXELS = 12
MAX_REGION_PIXELS = 40  # along a side: 0.8 units and a margin
MAX_WHITE = 14  # pixels within one region: the robot's eyes; a gap between two has more
REGION_MARGIN = 0.36  # pixels between a region's outermost exact pixels and its edge


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
    """The workspace x of the centres of a frame's pixel column."""
    return (column + 0.5) * PIXEL - VIEW_HALF


@inlined
def pixel_y(row: float) -> float:
    """The workspace y of the centres of a frame's pixel row."""
    return VIEW_HALF - (row + 0.5) * PIXEL


@inlined
def classify(frame: Pixels, codes: Grid, kinds: Grid, robot_alone: bool) -> None:
    """Fill in each pixel's colour as one integer, and the kind of object that has it."""
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
    """Label all pixels of the start's kind that are connected to it."""
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


@inlined
def number_components(kinds: Grid, labels: Grid, stack: Grid) -> int:
    """Number all components from 1, in the order of their first pixels; returns how many."""
    number = 0
    for pixel in range(GRID * GRID):
        labels[pixel] = 0
    for start in range(GRID * GRID):
        if kinds[start] != NOTHING and labels[start] == 0:
            number += 1
            flood(kinds, labels, stack, start, number)
    return number


@inlined
def measure(
    codes: Grid, kinds: Grid, labels: Grid, number: int, parts: Ints, centres: Floats
) -> None:
    """Fill in each component's row of `parts` and its centre."""
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


@inlined
def find_regions(
    codes: Grid, parts: Ints, number: int, boxes: Ints, regions: Floats, colours: Ints
) -> None:
    """Fill in the centre, half width and half height, and the colour of each region.

    `boxes` is scratch memory with a row for every component.
    """
    found = 0
    for colour in range(len(REGIONS)):
        count = _boxes_of(parts, number, colour, boxes)
        while count > 0:
            k = 1
            while k < count:
                if _join(codes, boxes, k):
                    count = _drop_contained(boxes, count)
                    k = 1
                else:
                    k += 1
            if boxes[0, AREA] >= MIN_REGION_PIXELS and found < MAX_REGIONS:
                left, right = boxes[0, LEFT] - REGION_MARGIN, boxes[0, RIGHT] + 1 + REGION_MARGIN
                top, bottom = boxes[0, TOP] - REGION_MARGIN, boxes[0, BOTTOM] + 1 + REGION_MARGIN
                regions[found, 0] = (left + right) / 2 * PIXEL - VIEW_HALF
                regions[found, 1] = VIEW_HALF - (top + bottom) / 2 * PIXEL
                regions[found, 2] = (right - left) / 2 * PIXEL
                regions[found, 3] = (bottom - top) / 2 * PIXEL
                colours[found] = colour
                found += 1
            count -= 1
            for k in range(count):
                for i in range(5):
                    boxes[k, i] = boxes[k + 1, i]


@inlined
def _boxes_of(parts: Ints, number: int, colour: int, boxes: Ints) -> int:
    """Fill in areas and limits of a colour's region components, largest first; returns how many."""
    count = 0
    for k in range(1, number + 1):
        if parts[k, KIND] == REGION and parts[k, COLOUR] == colour:
            at = count
            while at > 0 and boxes[at - 1, AREA] < parts[k, AREA]:
                for i in range(5):
                    boxes[at, i] = boxes[at - 1, i]
                at -= 1
            for i in range(5):
                boxes[at, i] = parts[k, i]
            count += 1
    return count


@inlined
def _join(codes: Grid, boxes: Ints, k: int) -> bool:
    """Extend the first box to the k-th if both can be one region; returns whether they can."""
    top, bottom = min(boxes[0, TOP], boxes[k, TOP]), max(boxes[0, BOTTOM], boxes[k, BOTTOM])
    left, right = min(boxes[0, LEFT], boxes[k, LEFT]), max(boxes[0, RIGHT], boxes[k, RIGHT])
    if max(bottom - top, right - left) >= MAX_REGION_PIXELS:
        return False
    white = 0
    for row in range(top, bottom + 1):
        for column in range(left, right + 1):
            white += codes[(row + 1) * GRID + column + 1] == WHITE_CODE
    if white > MAX_WHITE:
        return False
    boxes[0, AREA] += boxes[k, AREA]
    boxes[0, TOP], boxes[0, BOTTOM], boxes[0, LEFT], boxes[0, RIGHT] = top, bottom, left, right
    return True


@inlined
def _drop_contained(boxes: Ints, count: int) -> int:
    """Remove the boxes within the first one; returns how many are left, including it."""
    left = 1
    for k in range(1, count):
        rows = boxes[0, TOP] <= boxes[k, TOP] and boxes[0, BOTTOM] >= boxes[k, BOTTOM]
        columns = boxes[0, LEFT] <= boxes[k, LEFT] and boxes[0, RIGHT] >= boxes[k, RIGHT]
        if not (rows and columns):
            for i in range(5):
                boxes[left, i] = boxes[k, i]
            left += 1
    return left
