"""Objects from pixels: robot, blocks and goal regions of allocentric 96 x 96 frames.

The parser is made for the benchmark's palette and shapes (docs/specification.md, sections 2, 3, 4
and 6); only the constants of the shape classifier and of the fingers were fitted, on rendered
scenes. The interiors of objects have exact colours; only pixels on edges are mixed. So a block is a
connected component of a fill colour (its darker outline separates touching blocks), a goal region
is the bounding rectangle of components of a region colour, and the robot's body is the grey disc
around the eyes. Parts of a region that something splits are joined if no empty workspace lies
between them. Grids are flat, with a border of one pixel around the frame.
"""

import math
from collections.abc import Callable, Iterable
from functools import partial
from operator import itemgetter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from magical.compiled import inlined, kernel
from magical.errors import PluginError
from magical.plugins import load_reference
from magical.render.kernel import VIEW_WIDTH
from magical.render.palette import GREY, RGB, SHADES, WHITE
from magical.scene import COLOURS
from magical.scene.constants import FINGER_ROOT_X, FINGER_ROOT_Y, FRAME_SIZE, ROBOT_RADIUS, SIDES

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

PARSER = "parser"  # the name of `parse_frames`
MAX_BLOCKS = 10  # the most in any of the benchmark's tasks
FAR = 9.0  # units: the coordinates of absent blocks
ABSENT = -1  # the colour and shape of absent objects

MIN_BLOCK_PIXELS = 12  # smaller components are slivers next to another object

# The shape classifier is linear in `_shape_features`; a row for each of `SHAPES`.
SHAPE_WEIGHTS = np.array(
    (
        (1.05, -3.01, 8.42, -1.65, -2.47, 0.08, 3.28, -0.32, 5.45),
        (42.8, 2.05, -2.57, -14.26, 1.82, -0.98, -4.2, 0.87, -36.0),
        (-9.89, 0.12, -4.88, 10.2, -0.92, -0.74, 1.27, -0.79, 15.23),
        (-33.97, 0.84, -0.97, 5.71, 1.57, 1.64, -0.34, 0.25, 15.32),
    )
)
# A finger's angle is linear in the mean direction of its pixels from its root.
FINGER_SLOPE, FINGER_OFFSET = 1.0081, 0.0696  # rad
FINGER_REACH = 0.42  # units from the robot's centre to beyond the fingertips
FINGER_WINDOW = 23  # pixels to either side of the robot's centre
BODY_WINDOW = 11
FEATURES = 9


class ParsedFrames(NamedTuple):
    """The objects in B frames, in workspace units; blocks and regions in no particular order."""

    robot: Floats  # (B, 3) x, y, angle
    fingers: Floats  # (B, 2) opening angles of the left and the right finger, rad
    blocks: Floats  # (B, MAX_BLOCKS, 2)
    colours: Ints  # (B, MAX_BLOCKS) positions in COLOURS
    shapes: Ints  # (B, MAX_BLOCKS) positions in SHAPES
    regions: Floats  # (B, MAX_REGIONS, 4) centre x and y, half width and half height
    region_colours: Ints  # (B, MAX_REGIONS)

    def select(self, frames: slice) -> "ParsedFrames":
        """Some of the frames."""
        return ParsedFrames(*map(itemgetter(frames), self))

    @staticmethod
    def joined(parts: Iterable["ParsedFrames"]) -> "ParsedFrames":
        """All frames of the parts, in order."""
        return ParsedFrames(*map(np.concatenate, zip(*parts, strict=True)))


def parse_frames(
    frames: Pixels, robot_alone: bool = False, features: Floats | None = None
) -> ParsedFrames:
    """Parse allocentric frames (B, 96, 96, 3) uint8, in any memory layout.

    Finds only the robot's pose with `robot_alone`; `features`, (B, MAX_BLOCKS, 9), is filled with
    what shapes are classified by.
    """
    count = len(frames)
    blocks, regions = (count, MAX_BLOCKS), (count, MAX_REGIONS)
    parsed = ParsedFrames(
        np.zeros((count, 3)),
        np.zeros((count, 2)),
        np.full((*blocks, 2), FAR),
        np.full(blocks, ABSENT, np.int64),
        np.full(blocks, ABSENT, np.int64),
        np.zeros((*regions, 4)),
        np.full(regions, ABSENT, np.int64),
    )
    features = np.zeros((*blocks, FEATURES)) if features is None else features
    pixels = frames
    if not frames.flags.c_contiguous:
        pixels = np.empty(frames.shape, np.uint8)
        for channel in range(frames.shape[3]):  # all at once takes three times as long
            pixels[..., channel] = frames[..., channel]
    compiled_parse(pixels, robot_alone, features, *parsed)
    return parsed


Perception = Callable[..., ParsedFrames]  # called as `parse_frames`, with `robot_alone`


def get_perception(name: str) -> Perception:
    """The parser, or the function that `module:NAME` refers to.

    Raises:
        PluginError: it cannot be imported, fails for a white frame, or returns something else.
    """
    if name == PARSER:
        return parse_frames
    perception: Perception = load_reference(name)
    blank = np.full((1, FRAME_SIZE, FRAME_SIZE, 3), 255, np.uint8)
    expected = _layout(parse_frames(blank))
    try:
        parsed = perception(blank, robot_alone=True)
    except Exception as error:  # it may raise anything
        reason = f"{type(error).__name__}: {error}"
        raise PluginError(f"perception {name!r}: fails for a white frame: {reason}") from error
    found = _layout(parsed) if isinstance(parsed, ParsedFrames) else type(parsed).__name__
    if found != expected:
        raise PluginError(
            f"perception {name!r}: expected ParsedFrames of {expected} for one frame, found {found}"
        )
    return partial(_compacted, perception)


def _layout(parsed: ParsedFrames) -> str:
    """The type and shape of each array."""
    return ", ".join(f"{column.dtype} {column.shape}" for column in parsed)


def _compacted(perception: Perception, frames: Pixels, robot_alone: bool = False) -> ParsedFrames:
    """The perceived objects, with the blocks in the first slots, as the parser returns them."""
    parsed = perception(frames, robot_alone=robot_alone)
    order = np.argsort(parsed.colours == ABSENT, axis=1, kind="stable")
    return parsed._replace(
        blocks=np.take_along_axis(parsed.blocks, order[:, :, None], axis=1),
        colours=np.take_along_axis(parsed.colours, order, axis=1),
        shapes=np.take_along_axis(parsed.shapes, order, axis=1),
    )


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
                boxes[k, :5] = boxes[k + 1, :5]


@inlined
def _boxes_of(parts: Ints, number: int, colour: int, boxes: Ints) -> int:
    """Fill in areas and limits of a colour's region components, largest first; returns how many."""
    count = 0
    for k in range(1, number + 1):
        if parts[k, KIND] == REGION and parts[k, COLOUR] == colour:
            at = count
            while at > 0 and boxes[at - 1, AREA] < parts[k, AREA]:
                boxes[at, :5] = boxes[at - 1, :5]
                at -= 1
            boxes[at, :5] = parts[k, :5]
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
            boxes[left, :5] = boxes[k, :5]
            left += 1
    return left


@kernel
def compiled_parse(
    frames: Pixels,
    robot_alone: bool,
    features: Floats,
    robot: Floats,
    fingers: Floats,
    blocks: Floats,
    colours: Ints,
    shapes: Ints,
    regions: Floats,
    region_colours: Ints,
) -> None:
    """Fill the initialised arrays of `ParsedFrames`, or only `robot`."""
    pixels = GRID * GRID
    codes, kinds, labels, outside, stack = np.zeros((5, pixels), np.int32)
    parts, centres = np.zeros((pixels, 7), np.int64), np.zeros((pixels, 2))
    boxes = np.zeros((pixels, 5), np.int64)
    for b in range(len(frames)):
        classify(frames[b], codes, kinds, robot_alone)
        number = number_components(kinds, labels, stack)
        measure(codes, kinds, labels, number, parts, centres)
        pose = _find_robot(frames[b], labels, parts, number, kinds, outside, stack)
        robot[b, 0], robot[b, 1], robot[b, 2] = pose
        if not robot_alone:
            _find_fingers(frames[b], robot[b], fingers[b])
            _find_blocks(
                labels, parts, centres, number, features[b], blocks[b], colours[b], shapes[b]
            )
            find_regions(codes, parts, number, boxes, regions[b], region_colours[b])


@inlined
def _start(centre: float, half: int) -> int:
    """The first pixel of a window around a centre, shifted to lie within the frame."""
    return int(min(max(np.rint(centre) - half, 0.0), FRAME_SIZE - 1.0 - 2 * half))


@inlined
def _find_robot(
    frame: Pixels, labels: Grid, parts: Ints, number: int, near: Grid, outside: Grid, stack: Grid
) -> tuple[float, float, float]:
    """The pose, from the disc of the largest grey component and its holes, the eyes."""
    body, top, left = _find_body(labels, parts, number)
    _flood_around(labels, body, top, left, near, outside, stack)
    size = 2 * BODY_WINDOW + 1
    in_rows, in_columns = np.zeros((2, size)), np.zeros((2, size))  # of disc, of eyes
    eyes = np.zeros((size, size))
    for i in range(size):
        for j in range(size):
            at = (i + 2) * GRID + j + 2
            if not outside[at]:
                if near[at] == OPEN:
                    eyes[i, j] = _contrast(frame, top + i, left + j)
                in_rows[0, i] += 1.0
                in_columns[0, j] += 1.0
                in_rows[1, i] += eyes[i, j]
                in_columns[1, j] += eyes[i, j]
    x, y = _window_centre(in_rows[0], in_columns[0], top, left)
    middle_x, middle_y = _window_centre(in_rows[1], in_columns[1], top, left)
    xx = yy = xy = 0.0
    for i in range(size):
        dx, dy = pixel_x(left + i) - middle_x, pixel_y(top + i) - middle_y
        xx += in_columns[1, i] * dx * dx
        yy += in_rows[1, i] * dy * dy
        for j in range(size):
            xy += eyes[i, j] * dy * (pixel_x(left + j) - middle_x)
    # The line through both eyes gives the angle up to a half turn; the side of the body that they
    # are on resolves the rest.
    line = 0.5 * math.atan2(2 * xy, xx - yy)
    rough = math.atan2(x - middle_x, middle_y - y)
    return x, y, rough + (line - rough + math.pi / 2) % math.pi - math.pi / 2


@inlined
def _find_body(labels: Grid, parts: Ints, number: int) -> tuple[int, int, int]:
    """The number of the largest grey component, and the first row and column of a window on it."""
    body, area = ABSENT, 0
    for k in range(1, number + 1):
        if parts[k, KIND] == BODY and parts[k, AREA] >= area:
            body, area = k, parts[k, AREA]
    rows = columns = 0
    for row in range(FRAME_SIZE):
        for column in range(FRAME_SIZE):
            if labels[(row + 1) * GRID + column + 1] == body:
                rows += row
                columns += column
    area = max(area, 1)
    return body, _start(rows / area, BODY_WINDOW), _start(columns / area, BODY_WINDOW)


@inlined
def _contrast(frame: Pixels, row: int, column: int) -> float:
    """How much of an eye a pixel shows, up to 1, from its difference from grey."""
    contrast = 0
    for channel in range(3):
        contrast = max(contrast, abs(int(frame[row, column, channel]) - GREY_LEVELS[channel]))
    return min(contrast / 60.0, 1.0)  # 60: half covered by an eye


@inlined
def _flood_around(
    labels: Grid, body: int, top: int, left: int, near: Grid, outside: Grid, stack: Grid
) -> None:
    """Mark, in `outside`, the pixels of a window that are connected to its surroundings.

    The window's first pixel is in row 2 and column 2 of `near` and `outside`; `near` gets BODY or
    OPEN.
    """
    for pixel in range(GRID * GRID):
        near[pixel], outside[pixel] = NOTHING, 0
    size = 2 * BODY_WINDOW + 1
    for row in range(size + 2):
        for column in range(size + 2):
            within = 0 < row <= size and 0 < column <= size
            own = within and labels[(top + row) * GRID + left + column] == body
            near[(row + 1) * GRID + column + 1] = BODY if own else OPEN
    flood(near, outside, stack, GRID + 1, 1)


@inlined
def _window_centre(rows: Floats, columns: Floats, top: int, left: int) -> tuple[float, float]:
    """The centroid of weights in a window, given their sums for each row and column."""
    total = x = y = 0.0
    for i in range(len(rows)):
        total += columns[i]
        x += columns[i] * pixel_x(left + i)
        y += rows[i] * pixel_y(top + i)
    total = max(total, 1e-9)
    return x / total, y / total


@inlined
def _find_fingers(frame: Pixels, robot: Floats, fingers: Floats) -> None:
    """Find the opening angles of the fingers from the mean direction of their pixels."""
    x, y, cos, sin = robot[0], robot[1], math.cos(robot[2]), math.sin(robot[2])
    top = _start((VIEW_HALF - y) / PIXEL - 0.5, FINGER_WINDOW)
    left = _start((x + VIEW_HALF) / PIXEL - 0.5, FINGER_WINDOW)
    totals, weights = np.zeros(2), np.zeros(2)
    for row in range(top, top + 2 * FINGER_WINDOW + 1):
        for column in range(left, left + 2 * FINGER_WINDOW + 1):
            red, green, blue = frame[row, column, 0], frame[row, column, 1], frame[row, column, 2]
            brightest, darkest = max(red, green, blue), min(red, green, blue)
            if brightest - darkest > 16 or brightest >= 247:
                continue
            place_x, place_y = pixel_x(column), pixel_y(row)
            dx, dy = place_x - x, place_y - y
            across, ahead = dx * cos + dy * sin, dy * cos - dx * sin  # in the robot's frame
            reach = math.hypot(across, ahead)
            near = ROBOT_RADIUS + 0.015 < reach < FINGER_REACH and ahead > 0.2
            # The workspace's edge is grey as well.
            if near and abs(place_x) < 0.98 and abs(place_y) < 0.98:
                darkness = min(max((250.0 - brightest) / 45.0, 0.0), 1.0)
                for k in range(2):
                    out = across * SIDES[k]
                    if out > -0.015:
                        direction = math.atan2(out - FINGER_ROOT_X, ahead - FINGER_ROOT_Y)
                        totals[k] += darkness * direction
                        weights[k] += darkness
    for k in range(2):
        fingers[k] = FINGER_SLOPE * totals[k] / (weights[k] + 1e-6) + FINGER_OFFSET


@inlined
def _find_blocks(
    labels: Grid,
    parts: Ints,
    centres: Floats,
    number: int,
    features: Floats,
    blocks: Floats,
    colours: Ints,
    shapes: Ints,
) -> None:
    found = 0
    for k in range(1, number + 1):
        if parts[k, KIND] != BLOCK or parts[k, AREA] < MIN_BLOCK_PIXELS or found == MAX_BLOCKS:
            continue
        _shape_features(labels, parts, centres, k, features[found])
        best, shape = -math.inf, 0
        for kind in range(len(SHAPE_WEIGHTS)):
            score = 0.0
            for i in range(FEATURES):
                score += features[found, i] * SHAPE_WEIGHTS[kind, i]
            if score > best:
                best, shape = score, kind
        blocks[found, 0], blocks[found, 1] = centres[k, 0], centres[k, 1]
        colours[found], shapes[found] = parts[k, COLOUR], shape
        found += 1


@inlined
def _shape_features(labels: Grid, parts: Ints, centres: Floats, k: int, features: Floats) -> None:
    """Compute a component's area, moments, and strength of four- and five-fold symmetry."""
    second = fourth = cos_4 = sin_4 = cos_5 = sin_5 = 0.0
    for row in range(parts[k, TOP], parts[k, BOTTOM] + 1):
        for column in range(parts[k, LEFT], parts[k, RIGHT] + 1):
            if labels[(row + 1) * GRID + column + 1] == k:
                dx, dy = (
                    (pixel_x(column) - centres[k, 0]) / PIXEL,
                    (pixel_y(row) - centres[k, 1]) / PIXEL,
                )
                square, direction = dx * dx + dy * dy, math.atan2(dy, dx)
                second += square
                fourth += square**2
                cos_4 += square * math.cos(4 * direction)
                sin_4 += square * math.sin(4 * direction)
                cos_5 += square * math.cos(5 * direction)
                sin_5 += square * math.sin(5 * direction)
    area, second = float(parts[k, AREA]), max(second, 1e-9)
    four, five = 5 * math.hypot(cos_4, sin_4) / second, 5 * math.hypot(cos_5, sin_5) / second
    spread = 100 * (second / area**2 - 0.16)
    features[0], features[1], features[2], features[3] = area / 60, spread, four, five
    features[4], features[5], features[6] = 100 * fourth / area**3, five**2, four**2
    features[7], features[8] = spread**2, 1.0
