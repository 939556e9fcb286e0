"""Compiled parts of planning: rollouts of plans, and overlaps with blocks and walls.

They are apart from their users, which import from other rooms: the key of compiled code on disk
has the sources of this folder alone (see `magical.compiled.cache`).
"""

import math

import numpy as np
from numpy.typing import NDArray

from magical.compiled.jit import nogil_entry_point
from magical.learning.planning.motion import Floats

FINGERS = np.array([[-0.2, 0.26], [0.2, 0.26], [-0.22, 0.12], [0.22, 0.12]])  # (right, ahead)
FINGER_ROOM = 0.13  # units from there to a block's centre


@nogil_entry_point
def compiled_roll_out(
    commands: NDArray[np.int64],
    pose: Floats,
    speeds: Floats,
    drive: Floats,
    turn: Floats,
    limit: float,
    poses: Floats,
) -> None:
    """Fill in the poses (HORIZON, M, 3) of plans' commands from a pose and its speeds."""
    for plan in range(commands.shape[1]):
        speed, spin = speeds[0], speeds[1]
        x, y, angle = pose[0], pose[1], pose[2]
        for step in range(commands.shape[0]):
            speed *= drive[0]
            if commands[step, plan, 0]:
                speed += drive[1 + (commands[step, plan, 0] > 0)]
            spin = turn[0] * spin + turn[1] * commands[step, plan, 1]
            new_x = x - math.sin(angle + spin / 2) * speed
            new_y = y + math.cos(angle + spin / 2) * speed
            if abs(new_x) <= limit and abs(new_y) <= limit:
                x, y = new_x, new_y
            angle += spin
            poses[step, plan, 0], poses[step, plan, 1], poses[step, plan, 2] = x, y, angle


@nogil_entry_point
def compiled_overlaps(
    poses: Floats, blocks: Floats, body: float, limit: float, overlaps: Floats
) -> None:
    """Fill in how deep (P,) the robot at poses (P, 3) is in blocks (N, 2) and walls, in units."""
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
