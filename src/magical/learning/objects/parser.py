"""Objects from pixels: robot, blocks and goal regions of allocentric 96 x 96 frames.

The parser is made for the benchmark's palette and shapes (docs/specification.md, sections 2, 3, 4
and 6); only the constants of the shape classifier and of the fingers were fitted, on rendered
scenes. The interiors of objects have exact colours; only pixels on edges are mixed. So a block is a
component of a fill colour (its darker outline separates touching blocks), a goal region is a
rectangle of a region colour, and the robot's body is the grey disc around the eyes.
"""

import math
from collections.abc import Iterable
from operator import itemgetter
from typing import NamedTuple

import numpy as np

from magical.compiled import inlined, kernel
from magical.learning.objects.components import (
    AREA,
    BLOCK,
    BODY,
    BOTTOM,
    COLOUR,
    GREY_LEVELS,
    GRID,
    KIND,
    LEFT,
    MAX_REGIONS,
    NOTHING,
    OPEN,
    PIXEL,
    RIGHT,
    TOP,
    VIEW_HALF,
    Floats,
    Grid,
    Ints,
    Pixels,
    classify,
    find_regions,
    flood,
    measure,
    number_components,
    pixel_x,
    pixel_y,
)
from magical.scene.constants import FINGER_ROOT_X, FINGER_ROOT_Y, FRAME_SIZE, ROBOT_RADIUS, SIDES

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
    """Parse allocentric frames (B, 96, 96, 3).

    Args:
        frames: uint8, in any memory layout.
        robot_alone: find only the robot's pose.
        features: (B, MAX_BLOCKS, 9), filled with the features that block shapes are classified by.
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
