"""`magical_goals.objects.parser` without compiled code: all frames of a batch at once."""

from typing import Any, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy import ndimage

from magical.render.palette import GREY, RGB, SHADES, WHITE
from magical.scene.constants import FINGER_ROOT_X, FINGER_ROOT_Y, FRAME_SIZE, ROBOT_RADIUS, SIDES
from magical.scene.vocabulary import COLOURS
from magical_goals.objects.parser import (
    ABSENT,
    BODY_WINDOW,
    FAR,
    FINGER_OFFSET,
    FINGER_REACH,
    FINGER_SLOPE,
    FINGER_WINDOW,
    MAX_BLOCKS,
    MAX_REGION_PIXELS,
    MAX_REGIONS,
    MAX_WHITE,
    MIN_BLOCK_PIXELS,
    MIN_REGION_PIXELS,
    PIXEL,
    REGION_MARGIN,
    SHAPE_WEIGHTS,
    VIEW_HALF,
    ParsedFrames,
)

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Pixels = NDArray[np.uint8]
Codes = NDArray[np.int32]  # pixels as one integer each


def _code(colour: RGB) -> int:
    return colour[0] | colour[1] << 8 | colour[2] << 16


FILLS, REGIONS = (
    np.array([_code(getattr(SHADES[colour], part)) for colour in COLOURS])
    for part in ("fill", "region")
)

_IN_FRAME = np.zeros((3, 3, 3), np.bool_)  # neighbours within a frame of a batch, none between
_IN_FRAME[1] = ndimage.generate_binary_structure(2, 1)


def parse_frames(frames: Pixels) -> ParsedFrames:
    """Parse allocentric frames (B, 96, 96, 3)."""
    codes = _codes(frames)
    robot = parse_robot(frames, codes)
    fingers = _finger_angles(frames, robot)
    blocks, colours, shapes = _parse_blocks(codes)
    regions, region_colours = _parse_regions(codes)
    return ParsedFrames(robot, fingers, blocks, colours, shapes, regions, region_colours)


def parse_robot(frames: Pixels, codes: Codes | None = None) -> Floats:
    """The robot's pose (B, 3)."""
    grey = (_codes(frames) if codes is None else codes) == _code(GREY)
    body = _Window.around(_largest_components(grey), BODY_WINDOW)
    filled = ndimage.binary_fill_holes(body.values, _IN_FRAME)
    centre = body.centres(filled.astype(np.float64))
    pixels = body.cut(frames).astype(np.int16)
    contrast = _largest(np.abs(pixels - np.array(GREY, np.int16)))
    eyes = (filled & ~body.values) * np.clip(contrast / 60.0, 0.0, 1.0)  # 60: half in an eye
    return np.concatenate([centre, _heading(body, eyes, centre)[:, None]], axis=1)


def _codes(frames: Pixels) -> Codes:
    channels = np.zeros((*frames.shape[:-1], 4), np.uint8)
    for k in range(3):
        channels[..., k] = frames[..., k]
    codes: Codes = channels.view("<i4")[..., 0]
    return codes


def _coordinates(columns: NDArray[np.intp], rows: NDArray[np.intp]) -> tuple[Floats, Floats]:
    """The centres of pixels in the workspace."""
    x, y = columns.astype(np.float64) + 0.5, rows.astype(np.float64) + 0.5
    return x * PIXEL - VIEW_HALF, VIEW_HALF - y * PIXEL


class _Components(NamedTuple):
    """The connected components of each frame of a mask (B, 96, 96), and their pixels."""

    number: int
    labels: NDArray[np.intp]  # (P,) the component of each pixel
    frames: NDArray[np.intp]  # (P,)
    rows: NDArray[np.intp]  # (P,)
    columns: NDArray[np.intp]  # (P,)

    def total(self, values: Floats | None = None) -> Floats:
        """The sum of pixels' values (P,) over each component, or its area: (number,)."""
        return np.bincount(self.labels, values, self.number).astype(np.float64)

    def frame_of(self) -> Ints:
        """The frame of each component (number,)."""
        of = np.zeros(self.number, np.int64)
        of[self.labels] = self.frames
        return of


def _components(mask: NDArray[np.bool_]) -> _Components:
    tall = np.zeros((len(mask), FRAME_SIZE + 1, FRAME_SIZE), np.bool_)  # an empty row between
    tall[:, :-1] = mask  # frames: in two dimensions, labelling is faster
    labels, count = ndimage.label(tall.reshape(-1, FRAME_SIZE))
    labelled = labels.reshape(tall.shape)[:, :-1]
    pixels = np.flatnonzero(mask)
    frames, rows, columns = np.unravel_index(pixels, mask.shape)
    return _Components(int(count), labelled[mask] - 1, frames, rows, columns)


def _coloured_components(codes: Codes, colours: Ints) -> tuple[_Components, Ints]:
    """The components of all colours together, and each one's position in the colours' codes.

    Pixels of two of the colours must not touch.
    """
    mask = codes == colours[0]
    for colour in colours[1:]:
        mask |= codes == colour
    parts = _components(mask)
    found = np.zeros(parts.number, np.int64)
    found[parts.labels] = codes[mask]
    return parts, (found[:, None] == colours).argmax(axis=1)


def _largest_components(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The largest component of each frame's mask (B, 96, 96)."""
    parts = _components(mask)
    areas, frame_of = parts.total(), parts.frame_of()
    largest = np.zeros(len(mask), np.int64)
    by_area = np.argsort(areas)
    largest[frame_of[by_area]] = by_area  # the last assignment counts
    own = parts.labels == largest[parts.frames]
    found = np.zeros(mask.shape, np.bool_)
    found[parts.frames[own], parts.rows[own], parts.columns[own]] = True
    return found


class _Window(NamedTuple):
    """A square part of each of B frames, with the coordinates of its pixels."""

    values: NDArray[Any]  # (B, W, W)
    rows: NDArray[np.intp]  # (B, W)
    columns: NDArray[np.intp]  # (B, W)
    x: Floats  # (B, W)
    y: Floats  # (B, W)

    @staticmethod
    def at(frames: NDArray[Any], rows: Floats, columns: Floats, half: int) -> "_Window":
        """The parts of frames (B, 96, 96, ...) around pixels (B,), moved into the frames."""
        last, span = FRAME_SIZE - 1 - 2 * half, np.arange(2 * half + 1)
        starts = (np.clip(np.round(v) - half, 0, last).astype(np.intp) for v in (rows, columns))
        row, column = (start[:, None] + span for start in starts)
        window = _Window(frames[:0], row, column, *_coordinates(column, row))
        return window._replace(values=window.cut(frames))

    @staticmethod
    def around(masks: NDArray[np.bool_], half: int) -> "_Window":
        """The parts of masks (B, 96, 96) around their centres."""
        total, pixels = np.maximum(masks.sum(axis=(1, 2)), 1), np.arange(FRAME_SIZE)
        rows, columns = masks.sum(axis=2) @ pixels / total, masks.sum(axis=1) @ pixels / total
        return _Window.at(masks, rows, columns, half)

    def cut(self, frames: NDArray[Any]) -> NDArray[Any]:
        """The same part of other frames."""
        shape = self.rows.shape[1], self.columns.shape[1]
        windows = sliding_window_view(frames, shape, axis=(1, 2))  # (B, rows, columns, ..., W, W)
        found = windows[np.arange(len(frames)), self.rows[:, 0], self.columns[:, 0]]
        return np.moveaxis(found, (-2, -1), (1, 2))

    def centres(self, weights: Floats) -> Floats:
        """Centres (B, 2) of pixels' weights (B, W, W)."""
        total = np.maximum(weights.sum(axis=(1, 2)), 1e-9)
        x = (weights.sum(axis=1) * self.x).sum(axis=1) / total
        y = (weights.sum(axis=2) * self.y).sum(axis=1) / total
        return np.stack([x, y], axis=1)


def _largest(pixels: NDArray[Any]) -> NDArray[Any]:
    """The largest channel of pixels (..., 3); three times as fast as `max`."""
    largest: NDArray[Any] = np.maximum(np.maximum(pixels[..., 0], pixels[..., 1]), pixels[..., 2])
    return largest


def _heading(window: _Window, eyes: Floats, centre: Floats) -> Floats:
    """The robot's angle (B,) from the weights of its eyes' pixels (B, W, W).

    The line through both eyes gives the angle up to a half turn, and their side of the body the
    rest.
    """
    middle = window.centres(eyes)
    x, y = window.x - middle[:, :1], window.y - middle[:, 1:]  # (B, W) each
    xx = (eyes.sum(axis=1) * x * x).sum(axis=1)
    yy = (eyes.sum(axis=2) * y * y).sum(axis=1)
    xy = np.einsum("brc,br,bc->b", eyes, y, x)
    line = 0.5 * np.arctan2(2 * xy, xx - yy)
    forward = middle - centre
    rough = np.arctan2(-forward[:, 0], forward[:, 1])
    angles: Floats = rough + (line - rough + np.pi / 2) % np.pi - np.pi / 2
    return angles


def _finger_angles(frames: Pixels, robot: Floats) -> Floats:
    """How far the fingers are open (B, 2), from the mean direction of their pixels."""
    row, column = (VIEW_HALF - robot[:, 1]) / PIXEL - 0.5, (robot[:, 0] + VIEW_HALF) / PIXEL - 0.5
    window = _Window.at(frames, row, column, FINGER_WINDOW)
    brightest, darkest = _largest(window.values), ~_largest(~window.values)  # ~x is 255 - x
    number, rows, columns = np.nonzero((brightest - darkest <= 16) & (brightest < 247))
    x, y, pose = window.x[number, columns], window.y[number, rows], robot[number]
    dx, dy = x - pose[:, 0], y - pose[:, 1]
    cos, sin = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    across, ahead = dx * cos + dy * sin, dy * cos - dx * sin  # in the robot's frame
    reach = np.hypot(across, ahead)
    near = (reach > ROBOT_RADIUS + 0.015) & (reach < FINGER_REACH) & (ahead > 0.2)
    inside = (np.abs(x) < 0.98) & (np.abs(y) < 0.98)  # the workspace's edge is grey as well
    darkness = (250.0 - brightest[number, rows, columns]) / 45.0
    weights = (near & inside) * np.clip(darkness, 0.0, 1.0)
    angles = np.empty((len(frames), 2))
    for k, side in enumerate(SIDES):
        own = weights * (across * side > -0.015)
        directions = np.arctan2(across * side - FINGER_ROOT_X, ahead - FINGER_ROOT_Y)
        total, weight = (np.bincount(number, w, len(frames)) for w in (own * directions, own))
        angles[:, k] = FINGER_SLOPE * total / (weight + 1e-6) + FINGER_OFFSET
    return angles


def _parse_blocks(codes: Codes) -> tuple[Floats, Ints, Ints]:
    """Positions, colours and shapes of each frame's blocks."""
    parts, numbers = _coloured_components(codes, FILLS)
    areas = parts.total()
    x, y = _coordinates(parts.columns, parts.rows)
    centres = np.stack([parts.total(x), parts.total(y)], axis=1) / areas[:, None]
    kinds = (_shape_features(parts, centres, x, y) @ SHAPE_WEIGHTS.T).argmax(axis=1)
    frame_of = parts.frame_of()
    large = np.flatnonzero(areas >= MIN_BLOCK_PIXELS)
    large = large[np.argsort(frame_of[large], kind="stable")]
    places = np.arange(len(large)) - np.searchsorted(frame_of[large], frame_of[large])
    large, places = large[places < MAX_BLOCKS], places[places < MAX_BLOCKS]
    at = frame_of[large], places
    blocks = np.full((len(codes), MAX_BLOCKS, 2), FAR)
    colours, shapes = (np.full((len(codes), MAX_BLOCKS), ABSENT, np.int64) for _ in range(2))
    blocks[at], colours[at], shapes[at] = centres[large], numbers[large], kinds[large]
    return blocks, colours, shapes


def _shape_features(parts: _Components, centres: Floats, x: Floats, y: Floats) -> Floats:
    """Area, moments and the strength of four- and five-fold symmetry of components: (number, 9)."""
    dx, dy = (x - centres[parts.labels, 0]) / PIXEL, (y - centres[parts.labels, 1]) / PIXEL
    squares, directions = dx * dx + dy * dy, np.arctan2(dy, dx)
    area, second = parts.total(), np.maximum(parts.total(squares), 1e-9)
    fourth = parts.total(squares**2)
    four, five = (
        5
        * np.hypot(
            parts.total(squares * np.cos(k * directions)),
            parts.total(squares * np.sin(k * directions)),
        )
        / second
        for k in (4, 5)
    )
    spread = 100 * (second / area**2 - 0.16)
    one = np.ones(parts.number)
    columns = area / 60, spread, four, five, 100 * fourth / area**3, five**2, four**2, spread**2
    return np.stack([*columns, one], axis=1)


def _parse_regions(codes: Codes) -> tuple[Floats, Ints]:
    """Rectangles and colours of each frame's goal regions."""
    regions = np.zeros((len(codes), MAX_REGIONS, 4))
    colours = np.full((len(codes), MAX_REGIONS), ABSENT, np.int64)
    parts, numbers = _coloured_components(codes, REGIONS)
    boxes = _bounding_boxes(parts)
    groups = parts.frame_of() * len(REGIONS) + numbers
    used = np.zeros(len(codes), np.int64)
    for group in np.unique(groups):
        frame, number = divmod(int(group), len(REGIONS))
        for box in _merged(boxes[groups == group], codes[frame]):
            if box[4] >= MIN_REGION_PIXELS and used[frame] < MAX_REGIONS:
                regions[frame, used[frame]] = _rectangle(box)
                colours[frame, used[frame]] = number
                used[frame] += 1
    return regions, colours


def _bounding_boxes(parts: _Components) -> Ints:
    """First and last row, first and last column, and area of components: (number, 5)."""
    boxes = np.zeros((parts.number, 5), np.int64)
    boxes[:, [0, 2]] = FRAME_SIZE
    np.minimum.at(boxes[:, 0], parts.labels, parts.rows)
    np.maximum.at(boxes[:, 1], parts.labels, parts.rows)
    np.minimum.at(boxes[:, 2], parts.labels, parts.columns)
    np.maximum.at(boxes[:, 3], parts.labels, parts.columns)
    boxes[:, 4] = parts.total()
    return boxes


def _merged(boxes: Ints, codes: Codes) -> list[Ints]:
    """Boxes with those joined that robot or blocks have split: no workspace lies between."""
    left = list(boxes[np.argsort(-boxes[:, 4])])
    done: list[Ints] = []
    while left:
        box = left.pop(0)
        k = 0
        while k < len(left):
            joined = _joined(box, left[k])
            sides = joined[[1, 3]] - joined[[0, 2]] + 1
            inside = codes[joined[0] : joined[1] + 1, joined[2] : joined[3] + 1]
            if sides.max() <= MAX_REGION_PIXELS and (inside == _code(WHITE)).sum() <= MAX_WHITE:
                box, k = joined, 0
                left = [other for other in left if not _contains(box, other)]
            else:
                k += 1
        done.append(box)
    return done


def _joined(a: Ints, b: Ints) -> Ints:
    low, high = np.minimum(a, b), np.maximum(a, b)
    return np.array([low[0], high[1], low[2], high[3], a[4] + b[4]])


def _contains(a: Ints, b: Ints) -> bool:
    return bool(a[0] <= b[0] and a[1] >= b[1] and a[2] <= b[2] and a[3] >= b[3])


def _rectangle(box: Ints) -> tuple[float, float, float, float]:
    """Centre x and y, half the width and half the height of a box in units."""
    left, right = box[2] - REGION_MARGIN, box[3] + 1 + REGION_MARGIN
    top, bottom = box[0] - REGION_MARGIN, box[1] + 1 + REGION_MARGIN
    x, y = (left + right) / 2 * PIXEL - VIEW_HALF, VIEW_HALF - (top + bottom) / 2 * PIXEL
    return x, y, (right - left) / 2 * PIXEL, (bottom - top) / 2 * PIXEL
