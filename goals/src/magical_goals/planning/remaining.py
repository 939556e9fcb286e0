"""How many control steps remain from a pose: to a place, with a block to its place, to a grasp.

Motions are assumed to be turns on the spot and straight drives at top speed, forward or backward.
`speeds` (3,) is a row of `Motion.speeds`: units per step backward and forward, rad per step.
"""

import numpy as np

from magical.experts.geometry import CONTACT_DISTANCE, ROBOT_LIMIT, excess, wrap_angle
from magical.scene.constants import BLOCK_SIZE
from magical_goals.planning.kernels import compiled_overlaps
from magical_goals.planning.motion import Floats, Motion
from magical_goals.planning.routes import Search

BLOCK_LIMIT = 0.88  # units: largest coordinate of a carried block's centre
APART = 2 * BLOCK_SIZE  # units between the centres of blocks
ROOM, BLOCK_ROOM, TARGET_ROOM = 0.02, 0.1, 0.1  # extra units: on routes past blocks; with a block;
# and past the block to be grasped, which must not be moved before
DIRECTIONS = 16  # number of directions from which a block can be grasped
RUN_UP = 0.14  # units driven straight ahead before a grasp
FIT = 0.7  # share of the demonstrated sideways distance that grasps aim for
HIT = 60.0  # control steps per unit of overlap
DETOUR = 1.1, 0.05  # factor, units: a route at most this much longer counts as straight
CLOSE = 0.05  # units: closer to its place, the robot need not face it
ARRIVAL = 0.1  # units from the run-up's start: closer, the robot turns towards its direction

_ANGLES = np.arange(DIRECTIONS) * 2 * np.pi / DIRECTIONS
_AHEAD = np.stack([-np.sin(_ANGLES), np.cos(_ANGLES)], axis=1)  # (DIRECTIONS, 2)


def obstruction(poses: Floats, blocks: Floats, body: float = CONTACT_DISTANCE) -> Floats:
    """Control steps (...) that blocks (N, 2) and walls cost the robot at poses (..., 3)."""
    costs = np.empty(poses.shape[:-1])
    compiled_overlaps(poses.reshape(-1, 3), blocks, body, ROBOT_LIMIT, costs.reshape(-1))
    return HIT * costs


def steps_to_place(
    place: Floats, ends: Floats, others: Floats, speeds: Floats, search: Search, reach: float = 0.0
) -> Floats:
    """Control steps (M,) until the robot, or a block `reach` ahead of it, is at a place.

    Args:
        place: (2,).
        ends: (M, 3), the poses to start from.
        others: (N, 2), blocks in the way.
        speeds: see the module.
        search: finds routes to the place.
        reach: units; 0 for the robot itself.
    """
    limit, room = (
        (BLOCK_LIMIT, APART + BLOCK_ROOM) if reach else (ROBOT_LIMIT, CONTACT_DISTANCE + ROOM)
    )
    routes = search(place[None], np.zeros(1), others, np.full(len(others), room), limit)
    moved = ends[:, :2] + reach * np.stack([-np.sin(ends[:, 2]), np.cos(ends[:, 2])], axis=1)
    length, direction = routes.at(moved)
    offset = place - ends[:, :2]
    distance = np.linalg.norm(offset, axis=1)
    straight = length < DETOUR[0] * np.linalg.norm(place - moved, axis=1) + DETOUR[1]
    exactly = offset / np.maximum(distance, 1e-6)[:, None]
    direction = np.where(straight[:, None], exactly, direction)
    turn = np.abs(wrap_angle(_angle(direction) - ends[:, 2]))
    if not reach:
        turn *= np.minimum(1.0, distance / CLOSE)
    gap = np.where(straight, distance - reach, length)
    ahead = np.where(gap > 0, gap / speeds[1], -gap / speeds[0]) + turn / speeds[2]
    gap = np.where(straight, distance + reach, length)
    back = gap / speeds[0] + (np.pi - turn) / speeds[2]
    outside = [  # where the robot would have to end up
        HIT * excess(place + side * reach * direction, ROBOT_LIMIT).sum(axis=1) for side in (-1, 1)
    ]
    steps: Floats = np.minimum(ahead + outside[0], back + outside[1])
    return steps


def steps_to_grasp(
    block: Floats, ends: Floats, others: Floats, motion: Motion, search: Search
) -> Floats:
    """Control steps (M,) from poses (M, 3) until a block (2,) lies between the fingers.

    Near the block, the robot can turn and drive straight on; from farther away, it first drives to
    the start of a run-up for which neither walls nor others (N, 2) are in the way of the grasp.
    """
    aside, reach, _ = motion.grasp
    speeds = motion.speeds[0]
    stances = block - reach * _AHEAD
    crowd = obstruction(np.column_stack([stances, _ANGLES]), others)  # (DIRECTIONS,)
    offset = block - ends[:, :2]
    distance = np.linalg.norm(offset, axis=1)
    facing = _angle(offset)
    turn = (np.abs(wrap_angle(facing - ends[:, 2])) - FIT * aside / distance).clip(min=0.0)
    gap = (distance - reach).clip(min=0.0)
    nearest = np.rint(facing / _ANGLES[1]).astype(np.intp) % DIRECTIONS
    straight = turn / speeds[2] + gap / speeds[1] + crowd[nearest]
    around = _steps_to_run_up(block, ends, others, crowd, motion, search) + RUN_UP / speeds[1]
    near = np.minimum(straight, around)
    steps: Floats = np.where(distance > reach + 2 * RUN_UP, around, near)
    return steps


def _steps_to_run_up(
    block: Floats, ends: Floats, others: Floats, crowd: Floats, motion: Motion, search: Search
) -> Floats:
    """Control steps (M,) from poses (M, 3) to the start of the best run-up, facing the block."""
    back, forward, spin = motion.speeds[0]
    starts = block - (motion.grasp[1] + RUN_UP) * _AHEAD
    crowd = crowd + HIT * excess(starts, ROBOT_LIMIT).sum(axis=1)
    starts = starts.clip(-ROBOT_LIMIT, ROBOT_LIMIT)
    room = np.append(np.full(len(others), CONTACT_DISTANCE + ROOM), CONTACT_DISTANCE + TARGET_ROOM)
    routes = search(starts, crowd * forward, np.vstack([others, block]), room, ROBOT_LIMIT)
    length, direction = routes.at(ends[:, :2])
    goals = routes.goals(ends[:, :2])
    far = np.minimum(1.0, np.linalg.norm(starts[goals] - ends[:, :2], axis=1) / ARRIVAL)
    there = (1.0 - far) * np.abs(wrap_angle(_ANGLES[goals] - ends[:, 2]))
    way = _angle(direction)
    turns = [
        there + far * (np.abs(wrap_angle(a - ends[:, 2])) + np.abs(wrap_angle(_ANGLES[goals] - a)))
        for a in (way, way + np.pi)
    ]
    steps: Floats = np.minimum(length / forward + turns[0] / spin, length / back + turns[1] / spin)
    return steps


def _angle(directions: Floats) -> Floats:
    """The angles (...) of a robot that faces directions (..., 2)."""
    return np.arctan2(-directions[..., 0], directions[..., 1])
