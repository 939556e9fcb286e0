"""Compiled parts of planning: rollouts of plans, overlaps with blocks and walls, and routes.

They are kept separate from their users, which import from other rooms: the cache key of compiled
code covers only this folder's sources and those of the shared rooms (see `magical.compiled.cache`).
"""

import math

import numpy as np
from numpy.typing import NDArray

from magical.compiled.jit import nogil_entry_point
from magical_goals.planning.motion import Floats

FINGERS = np.array([[-0.2, 0.26], [0.2, 0.26], [-0.22, 0.12], [0.22, 0.12]])  # (right, ahead)
FINGER_ROOM = 0.13  # units to a block's centre


@nogil_entry_point
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


@nogil_entry_point
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
