"""Goal regions: the rectangles of each region colour's components.

A robot or block on a region splits it; parts are joined where no workspace lies between.
"""

from magical.compiled import inlined, merged
from magical.learning.objects.components import (
    AREA,
    BOTTOM,
    COLOUR,
    GRID,
    KIND,
    LEFT,
    PIXEL,
    REGION,
    REGIONS,
    RIGHT,
    TOP,
    VIEW_HALF,
    WHITE_CODE,
    Floats,
    Grid,
    Ints,
)

MAX_REGIONS = 3  # of the benchmark's tasks
MIN_REGION_PIXELS = 12
MAX_REGION_PIXELS = 40  # of a side: 0.8 units and a margin
MAX_WHITE = 14  # pixels within one region: the robot's eyes; a gap between two has more
REGION_MARGIN = 0.36  # pixels between a region's outermost exact pixels and its edge


@merged
def find_regions(
    codes: Grid, parts: Ints, number: int, boxes: Ints, regions: Floats, colours: Ints
) -> None:
    """Write centre, half the width and height, and colour of each region.

    `boxes` is memory for as many components as there are.
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
    """The areas and limits of the regions' components of a colour, largest first; how many."""
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
    """Extend the first box to the k-th if both can be one region."""
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
    """Remove the boxes within the first one; how many are left with it."""
    left = 1
    for k in range(1, count):
        rows = boxes[0, TOP] <= boxes[k, TOP] and boxes[0, BOTTOM] >= boxes[k, BOTTOM]
        columns = boxes[0, LEFT] <= boxes[k, LEFT] and boxes[0, RIGHT] >= boxes[k, RIGHT]
        if not (rows and columns):
            for i in range(5):
                boxes[left, i] = boxes[k, i]
            left += 1
    return left
