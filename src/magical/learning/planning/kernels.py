"""Compiled parts of planning: rollouts of plans, overlaps with blocks and walls, and routes.

They are kept separate from their users, which import from other rooms: the cache key of compiled
code covers only this folder's sources and those of the shared rooms (see `magical.compiled`).
"""

import math

import numpy as np
from numpy.typing import NDArray

from magical.compiled import kernel
from magical.learning.planning.motion import Floats

FINGERS = np.array([[-0.2, 0.26], [0.2, 0.26], [-0.22, 0.12], [0.22, 0.12]])  # (right, ahead)
FINGER_ROOM = 0.13  # units to a block's centre


@kernel
def compiled_roll_out(
    drives: NDArray[np.int64],
    turns: NDArray[np.int64],
    turning: NDArray[np.int64],
    pose: Floats,
    speeds: Floats,
    drive: Floats,
    turn: Floats,
    limit: float,
    poses: Floats,
) -> None:
    """Fill in the poses (HORIZON, M, 3) of plans, from a pose and its speeds; see `_Plans`."""
    angles = np.empty((*turns.shape, 3))  # sine and cosine halfway through steps, angle after them
    for each in range(turns.shape[0]):
        angle, spin = pose[2], speeds[1]
        for step in range(turns.shape[1]):
            spin = turn[0] * spin + turn[1] * turns[each, step]
            angles[each, step, 0] = math.sin(angle + spin / 2)
            angles[each, step, 1] = math.cos(angle + spin / 2)
            angle += spin
            angles[each, step, 2] = angle
    for plan in range(drives.shape[1]):
        x, y, speed = pose[0], pose[1], speeds[0]
        for step in range(drives.shape[0]):
            sin, cos, angle = angles[turning[plan], step]
            speed *= drive[0]
            if drives[step, plan]:
                speed += drive[1 + (drives[step, plan] > 0)]
            new_x, new_y = x - sin * speed, y + cos * speed
            if abs(new_x) <= limit and abs(new_y) <= limit:
                x, y = new_x, new_y
            poses[step, plan, 0], poses[step, plan, 1], poses[step, plan, 2] = x, y, angle


@kernel
def compiled_overlaps(
    poses: Floats, blocks: Floats, body: float, limit: float, overlaps: Floats
) -> None:
    """Fill in the overlaps (P,), in units, of the robot at poses (P, 3) with blocks and walls."""
    for at in range(len(poses)):
        x, y = poses[at, 0], poses[at, 1]
        sin, cos = math.sin(poses[at, 2]), math.cos(poses[at, 2])
        overlap = max(abs(x) - limit, 0.0) + max(abs(y) - limit, 0.0)
        for block in range(len(blocks)):
            dx, dy = blocks[block, 0] - x, blocks[block, 1] - y
            deepest = max(body - math.hypot(dx, dy), 0.0)
            right, ahead = dx * cos + dy * sin, dy * cos - dx * sin
            for finger in range(len(FINGERS)):
                away = math.hypot(right - FINGERS[finger, 0], ahead - FINGERS[finger, 1])
                deepest = max(deepest, FINGER_ROOM - away)
            overlap += deepest
        overlaps[at] = overlap


@kernel
def compiled_routes(
    where: Floats, lengths: Floats, slopes: Floats, length: Floats, direction: Floats
) -> None:
    """Fill in lengths (P,) and directions (P, 2) of the routes from points (P, 2), in cells.

    They are interpolated from the grid's lengths (SIDE, SIDE) and their slopes (SIDE, SIDE, 2).
    """
    for at in range(len(where)):
        low_x, low_y = int(where[at, 0]), int(where[at, 1])
        part_x, part_y = where[at, 0] - low_x, where[at, 1] - low_y
        total, slope_x, slope_y = 0.0, 0.0, 0.0
        for i in range(2):
            for j in range(2):
                share = abs(1 - i - part_x) * abs(1 - j - part_y)
                total += share * lengths[low_x + i, low_y + j]
                slope_x += share * slopes[low_x + i, low_y + j, 0]
                slope_y += share * slopes[low_x + i, low_y + j, 1]
        size = max(math.sqrt(slope_x * slope_x + slope_y * slope_y), 1e-9)
        length[at], direction[at, 0], direction[at, 1] = total, -slope_x / size, -slope_y / size
