"""Distances shared by several skills, and plane geometry of points and arrays of points.

The package's docstring explains the words "measured", "swept" and "tuned" in comments.
"""

import math
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from magical.scene import Point, lengths
from magical.scene.constants import (
    BLOCK_SIZE,
    CONTROL_RATE,
    DRIVE_SPEED_BACK,
    DRIVE_SPEED_FORWARD,
    ROBOT_RADIUS,
    TURN_MAX_BIAS,
    WORKSPACE_HALF,
)

Floats = NDArray[np.float64]
Ints = NDArray[np.intp]
Bools = NDArray[np.bool_]
Angle = TypeVar("Angle", float, Floats)

ROBOT_LIMIT = WORKSPACE_HALF - ROBOT_RADIUS  # units: largest coordinate of the robot's centre
CONTACT_DISTANCE = ROBOT_RADIUS + BLOCK_SIZE  # units between the centres of robot and block
DRIVING_CLEARANCE = CONTACT_DISTANCE + 0.02  # units to blocks driven past; margin tuned
HELD_DISTANCE = CONTACT_DISTANCE + 0.015  # units to a held block; measured: 0.333 to 0.364
BLOCK_SPACING = 2 * BLOCK_SIZE + 0.02  # units between two blocks side by side; margin tuned
WORKING_DISTANCE = 0.4  # units: blocks nearer than this hinder a grasp or a release; swept

TURN_STEP = TURN_MAX_BIAS / CONTROL_RATE  # rad: one control step of turning
DRIVE_STEP = DRIVE_SPEED_FORWARD / CONTROL_RATE  # units: one control step of driving
BACK_STEP = -DRIVE_SPEED_BACK / CONTROL_RATE  # units: one control step of backing


def wrap_angle(angle: Angle) -> Angle:
    """The same angle, or angles, in [-pi, pi)."""
    return (angle + math.pi) % (2 * math.pi) - math.pi


def bearing(start: Point, end: Point) -> float:
    """The angle of a robot at `start` that faces `end`: 0 is up, counter-clockwise positive."""
    return math.atan2(start[0] - end[0], end[1] - start[1])


def is_within(point: Point, limit: float) -> bool:
    """Whether both coordinates are at most `limit` in magnitude."""
    return abs(point[0]) <= limit and abs(point[1]) <= limit


def segment_distance(start: Point, end: Point, point: Point) -> float:
    """Distance from a point to the segment between `start` and `end`."""
    dx, dy = end[0] - start[0], end[1] - start[1]
    px, py = point[0] - start[0], point[1] - start[1]
    square = dx * dx + dy * dy
    along = 0.0 if square == 0.0 else max(0.0, min(1.0, (px * dx + py * dy) / square))
    return math.hypot(px - along * dx, py - along * dy)


def excess(points: Floats, limit: float) -> Floats:
    """By how much the magnitude of each coordinate exceeds a limit, or 0."""
    return np.maximum(0.0, np.abs(points) - limit)


def project_on_segments(starts: Floats, ends: Floats, points: Floats) -> tuple[Floats, Floats]:
    """Positions on segments (..., 2) of the points nearest to others (..., 2), and the distances.

    Returns:
        Shares (...) of the segments, from 0 at the start to 1 at the end, and distances (...).
    """
    along, offsets = ends - starts, points - starts
    square = np.maximum((along * along).sum(axis=-1), 1e-12)
    shares = ((offsets * along).sum(axis=-1) / square).clip(0.0, 1.0)
    return shares, lengths(offsets - shares[..., None] * along)
