"""A slow, plain renderer of the same frames, to compare the fast one with.

One sample frame is painted back to front: every polygon by testing all sample centres with exact
integers, every smoothed line by its coverage of all samples; then blocks of samples are averaged.
Nothing is shared with `magical.render`: colours, sizes and rules are written down a second time,
from docs/specification.md, section 6.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from magical.scene import (
    Poses,
    Scene,
    finger_polygons,
    rectangle,
    regular_polygon,
    rotate,
    shift,
    star_polygon,
)
from magical.scene import constants as c

Array = NDArray[Any]
GRID = 256  # vertices are rounded to this part of a sample
COLOURS = {
    "red": ((245, 129, 165), (243, 94, 141), (250, 190, 209)),
    "green": ((195, 208, 130), (183, 198, 105), (224, 231, 191)),
    "blue": ((135, 185, 211), (110, 170, 202), (194, 219, 233)),
    "yellow": ((254, 213, 123), (254, 201, 86), (254, 234, 188)),
}
GREY, GREY_OUTLINE, LIGHT = (162, 163, 175), (144, 145, 159), (231, 231, 234)
WHITE, PUPIL = (255, 255, 255), (26, 26, 26)


def render(scene: Scene, poses: Poses, view: str, size: int, samples: int) -> Array:
    """The frame (size, size, 3) uint8."""
    raw = _Frame(poses, view, size * samples)
    raw.fill([(-1, -1), (1, -1), (1, 1), (-1, 1)], WHITE)
    for line in raw.visible_sides([(-1, 1), (1, 1), (1, -1), (-1, -1)]):
        raw.line(line, 1.0, GREY)
    if view == "ego" and scene.regions:  # left by the allocentric frame before, all in view there
        last = scene.regions[-1]
        raw.counter = 2 * sum(math.ceil(384 / 2.04 * x - 1e-9) for x in (last.width, last.height))
    for region in scene.regions:
        left, top = region.x, region.y
        right, bottom = left + region.width, top - region.height
        corners = [(left, top), (right, top), (right, bottom), (left, bottom)]
        raw.fill(corners, COLOURS[region.colour][2])
        raw.dashes(corners, COLOURS[region.colour][0])
    parts = _robot(poses), [polygon for block in zip(scene.blocks, poses.blocks, strict=True)
                            for polygon in _block(*block)]  # fmt: skip
    for group in parts if scene.robot_first else reversed(parts):
        for corners, colour in group:
            raw.fill(corners, colour)
    blocks = raw.image[::-1].reshape(size, samples, size, samples, 3).astype(float)
    frame: Array = np.rint(blocks.mean(axis=(1, 3))).astype(np.uint8)
    return frame


def _block(block: Any, pose: Array) -> list[Any]:
    fill, outline, _ = COLOURS[block.colour]
    inset = 0.015
    shapes: tuple[Any, Any]
    if block.shape == "circle":
        shapes = _disc(100, c.BLOCK_SIZE), _disc(100, c.BLOCK_SIZE - inset)
    elif block.shape == "square":
        side = c.SQUARE_SIDE
        shapes = rectangle(side, side), rectangle(side - 2 * inset, side - 2 * inset)
    elif block.shape == "pentagon":
        smaller = c.PENTAGON_RADIUS - inset / math.cos(math.pi / 5)
        shapes = regular_polygon(5, c.PENTAGON_RADIUS), regular_polygon(5, smaller)
    else:
        outer, inner = c.STAR_OUTER_RADIUS, c.STAR_INNER_RADIUS
        shapes = star_polygon(outer, inner), star_polygon(outer - inset, inner - inset)
    return [(_at(pose, shapes[0]), outline), (_at(pose, shapes[1]), fill)]


def _robot(poses: Poses) -> list[Any]:
    r, robot = c.ROBOT_RADIUS, poses.bodies[0]
    fingers, eyes = poses.bodies[1:3], poses.bodies[3:5]
    parts: list[Any] = []
    for side, pose in zip((-1, 1), fingers, strict=True):
        parts += [(_at(pose, rect), GREY) for rect in finger_polygons(side)]
    for side, pose in zip((-1, 1), fingers, strict=True):
        for rect in finger_polygons(side, 0.02):
            parts.append((_at(pose, shift(rect, 0, 0.01)), LIGHT))
    parts.append((_at(robot, _disc(100, r)), GREY_OUTLINE))
    parts.append((_at(robot, _disc(100, r - 0.01)), GREY))
    for side in (-1, 1):
        eye = shift(_disc(20, 0.2 * r), side * 0.4 * r, 0.3 * r)
        parts.append((_at(robot, eye), WHITE))
    for side, eye_pose in zip((-1, 1), eyes, strict=True):
        centre = _at(robot, [(side * 0.4 * r, 0.3 * r)])[0]
        pupil = shift(_disc(10, 0.12 * r), 0, 0.07 * r)
        parts.append((_at((*centre, eye_pose[2]), pupil), PUPIL))
    return parts


def _disc(sides: int, radius: float) -> list[tuple[float, float]]:
    return [rotate((radius, 0.0), 2 * math.pi * i / sides) for i in range(sides)]


def _at(pose: Any, points: Any) -> list[tuple[float, float]]:
    x, y, angle = pose
    return [(x + dx, y + dy) for dx, dy in (rotate(point, angle) for point in points)]


class _Frame:
    """A frame of one sample a pixel, the lowest row first."""

    def __init__(self, poses: Poses, view: str, extent: int) -> None:
        self.extent = extent
        self.scale = extent / 2.04  # samples a unit
        self.unit = extent / 384  # samples a pixel of the 384 frame
        self.image = np.empty((extent, extent, 3), np.int64)
        self.image[:] = LIGHT
        self.camera = (0.0, 0.0, 0.0) if view == "allo" else tuple(poses.bodies[0])
        self.centre = np.array((extent / 2, extent * (0.5 if view == "allo" else 0.15)))
        self.view = view
        self.counter = 0  # of dashes

    def project(self, points: Any) -> Array:
        """Simulation points in samples, (n, 2)."""
        x, y, turn = self.camera
        moved = [rotate((px - x, py - y), -turn) for px, py in points]
        projected: Array = np.array(moved) * self.scale + self.centre
        return projected

    def window(self, points: Array, margin: float) -> tuple[slice, slice]:
        """The rows and columns of the frame within a margin of some points."""
        low = np.clip(np.floor(points.min(axis=0) - margin), 0, self.extent).astype(int)
        high = np.clip(np.ceil(points.max(axis=0) + margin), 0, self.extent).astype(int)
        return slice(low[1], high[1]), slice(low[0], high[0])

    def fill(self, corners: Any, colour: Any) -> None:
        """A polygon, convex or not, by the even-odd rule, exactly."""
        points = np.rint(self.project(corners) * GRID).astype(np.int64)
        rows, columns = self.window(points / GRID, 1)
        centres = np.arange(self.extent) * GRID + GRID // 2
        x, y = centres[None, columns], centres[rows, None]
        inside = np.zeros(np.broadcast(x, y).shape, bool)
        for (ax, ay), (bx, by) in zip(points, np.roll(points, -1, axis=0), strict=True):
            if ay != by:
                crosses = (ay <= y) != (by <= y)
                right = (x - ax) * (by - ay) - (y - ay) * (bx - ax)
                inside ^= crosses & (right >= 0 if by > ay else right <= 0)
        self.image[rows, columns][inside] = colour

    def visible_sides(self, corners: Any) -> list[Array | None]:
        """The sides of a rectangle, cut to the frame; None for those out of view."""
        points = self.project(corners)
        return [self._cut(a, b) for a, b in zip(points, np.roll(points, -1, axis=0), strict=True)]

    def _cut(self, a: Array, b: Array) -> Array | None:
        start, end = 0.0, 1.0
        for k in range(2):
            for bound, sign in ((0.0, 1.0), (float(self.extent), -1.0)):
                near, far = sign * (a[k] - bound), sign * (b[k] - bound)  # inside where positive
                if near < 0 and far < 0:
                    return None
                if near < 0:
                    start = max(start, near / (near - far))
                if far < 0:
                    end = min(end, near / (near - far))
        return np.array((a + start * (b - a), a + end * (b - a))) if start < end else None

    def line(self, ends: Array | None, width: float, colour: Any) -> None:
        """A smoothed line, blended in 8-bit steps."""
        if ends is None:
            return
        length = math.hypot(*(ends[1] - ends[0]))
        along = (ends[1] - ends[0]) / length
        middle = ends.mean(axis=0) - 1e-7
        width *= self.unit
        rows, columns = self.window(ends, width + 2)
        centres = np.arange(self.extent) + 0.5
        x, y = centres[None, columns] - middle[0], centres[rows, None] - middle[1]
        across = np.clip(width / 2 + 0.5 - abs(along[0] * y - along[1] * x), 0, min(width, 1))
        within = np.clip(length / 2 + 0.5 - abs(along[0] * x + along[1] * y), 0, 1)
        share = np.rint(across * within * 255)[..., None]
        over, under = np.array(colour) * share, self.image[rows, columns] * (255 - share)
        self.image[rows, columns] = np.rint(over / 255) + np.rint(under / 255)

    def dashes(self, corners: Any, colour: Any) -> None:
        """8 on, 8 off, counted in pixels of the 384 frame along the sides that are in view."""
        for i, ends in enumerate(self.visible_sides(corners)):
            if ends is None:
                continue
            if i == 0:
                self.counter = 0
            length = math.hypot(*(ends[1] - ends[0])) / self.unit
            count = math.ceil(length - 1e-9)
            on = [(self.counter + k) // 8 % 2 == 0 for k in range(count)]
            starts = [k for k in range(count) if on[k] and (k == 0 or not on[k - 1])]
            for start in starts:
                stop = next((k for k in range(start, count) if not on[k]), length)
                self.line(
                    ends[0] + np.array([[start], [stop]]) / length * (ends[1] - ends[0]),
                    2.5,
                    colour,
                )
            self.counter += count
