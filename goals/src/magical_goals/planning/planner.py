"""Control by planning: drive to a block, around the others, and take it to its place.

A plan is one or two actions, each repeated for a few control steps. All plans are rolled out with
the motion model learned from demonstrations. A plan costs the steps that it takes, the steps that
remain after it, and more if the robot or its block would run into something. The first action is
sampled: the cheaper its best plan, the more probable it is. A stuck robot acts more randomly.
"""

import math
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from magical.compiled import kernel
from magical.experts.geometry import CONTACT_DISTANCE, ROBOT_LIMIT, excess, wrap_angle
from magical.scene import ACTIONS, NOOP, Action, Gripper, to_continuous
from magical.scene.constants import BLOCK_SIZE
from magical_goals.objects.control import ROBOT_TARGET
from magical_goals.planning.motion import Floats, Motion, from_robot, robot_steps, to_robot
from magical_goals.planning.routes import Search

FIRST, SECOND = (1, 2, 3, 5), (1, 2, 4, 7)  # control steps of a plan's actions
HORIZON = 13  # control steps that are rolled out; the last one lets a gliding robot come to rest
CHECKED = 6  # plans per first action that are checked for obstacles, to save time
STRIDE = 2  # control steps between the poses that are checked
CLOSING = 2  # control steps of closing the fingers before a block is carried
TOLERANCE = 0.03  # units by which a block may lie outside the demonstrated grasps; twice if held
STANDING = 2.0  # control steps added to the cost of standing still, which might go on
SPREAD, STUCK_SPREAD = 0.1, 6.0  # control steps: differences in cost that hardly matter
STILL, STILL_ANGLE = 0.01, 0.05  # units, rad per step: a robot that moves less stands still
STUCK = 3  # control steps of standing still
NEAR, LINGERING = 0.08, 15  # units, control steps: a robot that stays this near this long is stuck

# What remains after a plan: turns on the spot and straight drives at top speed.
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
FINGERS = np.array([[-0.2, 0.26], [0.2, 0.26], [-0.22, 0.12], [0.22, 0.12]])  # (right, ahead)
FINGER_ROOM = 0.13  # units to a block's centre

MOVES = [each for each in ACTIONS if each.gripper is Gripper.OPEN]  # in the order of their numbers


class Situation(NamedTuple):
    """What the robot sees, and what it has to do."""

    pose: Floats  # (3,)
    before: Floats  # (3,) the pose a step ago
    blocks: Floats  # (N, 2)
    target: int  # a block's number, or ROBOT_TARGET
    place: Floats  # (2,) where the target has to go

    @property
    def others(self) -> Floats:
        """The blocks other than the target."""
        return self.blocks[[row for row in range(len(self.blocks)) if row != self.target]]


class _Plans(NamedTuple):
    """All M plans: equally many for each of MOVES, in that order."""

    steps: NDArray[np.intp]  # (M,) control steps
    drives: NDArray[np.int64]  # (HORIZON, M) -1, 0 or 1; 0 after the plan's end
    turns: NDArray[np.int64]  # (N, HORIZON) the distinct sequences of turns, likewise
    turning: NDArray[np.intp]  # (M,) the row of `turns` of each plan


def _all_plans() -> _Plans:
    moves = range(len(MOVES))
    alone = [(first, steps, first, 0) for first, steps in product(moves, FIRST)]
    both = [each for each in product(moves, FIRST, moves, SECOND) if each[0] != each[2]]
    first, steps, second, more = np.array(sorted(alone + both, key=lambda plan: plan[0])).T
    time = np.arange(HORIZON)[:, None]
    points = to_continuous(moves)[:, :2].astype(np.int64)
    then = np.where((time < steps + more)[..., None], points[second], 0)
    drives, turns = np.moveaxis(np.where((time < steps)[..., None], points[first], then), -1, 0)
    different, turning = np.unique(turns.T, axis=0, return_inverse=True)
    # In NumPy 2.0.0 the inverse is (M, 1).
    return _Plans(steps + more, np.ascontiguousarray(drives), different, turning.ravel())


PLANS = _all_plans()


class Planner:
    """Chooses the actions of one episode, from its start."""

    def __init__(self, motion: Motion) -> None:
        self.motion = motion
        self._search = Search()
        self._still_steps = 0  # how long the robot has been standing still
        self._here, self._near_steps = np.full(2, np.inf), 0  # a point, steps spent near it
        self._held_steps = 0  # how long the target has been between the fingers

    def act(self, seen: Situation, uniform: float | None) -> int:
        """The next action's number, sampled with `uniform` in [0, 1); None: the most probable."""
        speeds = robot_steps(seen.before, seen.pose)
        still = bool((np.abs(speeds) < (STILL, STILL_ANGLE)).all())
        self._still_steps = self._still_steps + 1 if still else 0
        if np.linalg.norm(seen.pose[:2] - self._here) > NEAR:
            self._here, self._near_steps = seen.pose[:2], 0
        self._near_steps += 1
        stuck = self._still_steps >= STUCK or self._near_steps >= LINGERING
        held = self._holds(seen)
        self._held_steps = self._held_steps + 1 if held else 0
        grip = Gripper.CLOSED if held else Gripper.OPEN
        if held and self._held_steps <= CLOSING:
            return Action(gripper=grip).id
        costs = self._costs(seen, speeds, held)
        chosen = int(costs.argmin())
        if uniform is not None:
            spread = STUCK_SPREAD if stuck else SPREAD
            cumulative = np.exp((costs.min() - costs) / spread).cumsum()
            chosen = int((uniform * cumulative[-1] >= cumulative).sum())
        return MOVES[chosen]._replace(gripper=grip).id

    def _holds(self, seen: Situation) -> bool:
        """Whether the target is where demonstrators close their fingers."""
        if seen.target == ROBOT_TARGET:
            return False
        right, ahead = to_robot(seen.pose, seen.blocks[seen.target])
        aside, _, farthest = self.motion.grasp
        more = 2 * TOLERANCE if self._held_steps else TOLERANCE
        return bool(abs(right) < aside + more and 0.0 < ahead < farthest + more)

    def _costs(self, seen: Situation, speeds: Floats, held: bool) -> Floats:
        """Control steps (9,) that the best plan starting with each of MOVES costs."""
        poses = self._roll_out(seen.pose, speeds, int(held))
        costs = PLANS.steps + self._remaining(seen, poses[-1], held)
        by_move = costs.reshape(len(MOVES), -1)
        rows = np.argsort(by_move, axis=1, kind="stable")[:, :CHECKED]
        best = (rows + by_move.shape[1] * np.arange(len(MOVES))[:, None]).ravel()
        costs = costs[best] + _collisions(seen, poses[1::STRIDE, best], held)
        cheapest: Floats = costs.reshape(len(MOVES), CHECKED).min(axis=1)
        cheapest[NOOP] += STANDING
        return cheapest

    def _roll_out(self, pose: Floats, speeds: Floats, held: int) -> Floats:
        """The poses (HORIZON, M, 3) of all plans; the robot stops at the workspace's edge."""
        poses = np.empty((HORIZON, len(PLANS.steps), 3))
        limit = max(ROBOT_LIMIT, float(np.abs(pose[:2]).max()))
        motion = self.motion.drive[held], self.motion.turn[held]
        compiled_roll_out(*PLANS[1:], pose, speeds, *motion, limit, poses)
        return poses

    def _remaining(self, seen: Situation, ends: Floats, held: bool) -> Floats:
        """Control steps (M,) that remain after the plans' ends (M, 3)."""
        if seen.target != ROBOT_TARGET and not held:
            return steps_to_grasp(
                seen.blocks[seen.target], ends, seen.others, self.motion, self._search
            )
        reach = float(to_robot(seen.pose, seen.blocks[seen.target])[1]) if held else 0.0
        speeds = self.motion.speeds[int(held)]
        return steps_to_place(seen.place, ends, seen.others, speeds, self._search, reach)


def _collisions(seen: Situation, paths: Floats, held: bool) -> Floats:
    """Control steps (M,) that walls and blocks on paths (K, M, 3) cost the robot and its block."""
    cost: Floats = obstruction(paths, seen.others).sum(axis=0)
    if seen.target == ROBOT_TARGET:
        return cost
    block = seen.blocks[seen.target]
    if not held:
        cost += obstruction(paths, block[None], body=0.0).sum(axis=0)
        return cost
    carried = from_robot(paths, to_robot(seen.pose, block))
    gaps = np.linalg.norm(carried[..., None, :] - seen.others, axis=-1)
    overlap = (APART - gaps).clip(min=0.0), excess(carried, BLOCK_LIMIT)
    cost += HIT * sum(each.sum(axis=(0, 2)) for each in overlap)
    return cost


def obstruction(poses: Floats, blocks: Floats, body: float = CONTACT_DISTANCE) -> Floats:
    """Control steps (...) that blocks (N, 2) and walls cost the robot at poses (..., 3)."""
    costs = np.empty(poses.shape[:-1])
    compiled_overlaps(poses.reshape(-1, 3), blocks, body, ROBOT_LIMIT, costs.reshape(-1))
    return HIT * costs


def steps_to_place(
    place: Floats, ends: Floats, others: Floats, speeds: Floats, search: Search, reach: float = 0.0
) -> Floats:
    """Control steps (M,) from poses (M, 3) until the robot, or a block `reach` ahead, is there.

    `others` (N, 2) are in the way; `speeds` (3,) is a row of `Motion.speeds`.
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
