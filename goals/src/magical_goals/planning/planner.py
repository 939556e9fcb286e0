"""Control by planning: drive to a block, around the others, and take it to its place.

A plan is one or two actions, each repeated for a few control steps. All plans are rolled out with
the motion model learned from demonstrations. A plan costs the steps that it takes, the steps that
remain after it, and more if the robot or its block would run into something. The first action is
sampled: the cheaper its best plan, the more probable it is. A stuck robot acts more randomly.
"""

from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from magical.experts.geometry import ROBOT_LIMIT, excess
from magical.scene import NOOP
from magical.scene.actions import ACTIONS, Action, Gripper, to_continuous
from magical_goals.objects.control import ROBOT_TARGET
from magical_goals.planning.kernels import compiled_roll_out
from magical_goals.planning.motion import Floats, Motion, from_robot, robot_steps, to_robot
from magical_goals.planning.remaining import (
    APART,
    BLOCK_LIMIT,
    HIT,
    obstruction,
    steps_to_grasp,
    steps_to_place,
)
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
