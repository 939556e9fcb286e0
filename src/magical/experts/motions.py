"""A motion model of robot and held block, and all short motions rolled out under it.

The model knows how fast top speeds are reached, and nothing of contacts. A motion is a pair of
actions, each repeated for a few control steps. At every control step the carrying skill picks the
motion after which the held block needs the least further time, and takes its first action.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from magical.experts.array_geometry import Floats, Ints
from magical.experts.distances import HELD_DISTANCE
from magical.scene.constants import (
    CONTROL_RATE,
    DRIVE_SPEED_BACK,
    DRIVE_SPEED_FORWARD,
    TURN_MAX_BIAS,
)

TURN_STEP = TURN_MAX_BIAS / CONTROL_RATE  # rad: one control step of turning
DRIVE_STEP = DRIVE_SPEED_FORWARD / CONTROL_RATE  # units: one control step of driving
BACK_STEP = -DRIVE_SPEED_BACK / CONTROL_RATE  # units: one control step of backing
OPEN_ACTIONS = 9  # actions with open fingers; those with closed fingers follow in their order


@dataclass(frozen=True, slots=True)
class MotionModel:
    """How robot and held block accelerate; the unit of time is a control step.

    Fitted by hand to the simulator: a test compares five steps of one action with it.
    """

    drive: float = 0.028  # units: change of velocity per step by the drive; measured
    drag: float = 0.0145  # units: change of velocity per step by the block's friction; measured
    spin_up: float = 0.085  # rad: change of turning per step; measured
    spin_stop: float = 0.33  # share of the present turning still turned on stopping; measured
    pivot: float = 0.06  # units ahead of the robot's centre about which both turn; measured


@dataclass(frozen=True, slots=True)
class MotionTableSettings:
    """Which motions are rolled out, and from which initial speeds. Tuned for time and scores."""

    first_steps: tuple[int, ...] = (1, 2, 3, 5)  # control steps of a motion's first action
    second_steps: tuple[int, ...] = (0, 1, 2, 4)  # and of its second action
    stride: int = 2  # control steps between the points of a path that are kept
    speeds: tuple[float, ...] = (-0.06, 0.0, 0.05, 0.1)  # units per control step
    spins: tuple[float, ...] = (-0.25, 0.0, 0.25)  # rad per control step


MODEL = MotionModel()
TABLE = MotionTableSettings()


@dataclass(frozen=True, slots=True)
class MotionTable:
    """N motions in the frame that the robot starts from, with K points of each path."""

    first: Ints  # (N,) ids of the first actions, fingers open, in ascending order
    time: Floats  # (N,) control steps
    robot: Floats  # (N, K, 2) path of the robot's centre; the last point is the end
    block: Floats  # (N, K, 2) path of a held block
    turned: Floats  # (N,) rad
    ahead: Floats  # (N, 2) unit vector ahead at the end
    right: Floats  # (N, 2) and to the right


def motion_table(speed: float, spin: float) -> MotionTable:
    """The motions from the initial speed (units / s) and turning (rad / s) nearest to the given."""
    return _table(_nearest(TABLE.speeds, speed), _nearest(TABLE.spins, spin))


def _nearest(values: Sequence[float], per_second: float) -> int:
    per_step = per_second / CONTROL_RATE
    return min(range(len(values)), key=lambda i: abs(values[i] - per_step))


@cache
def _table(speed: int, spin: int) -> MotionTable:
    sequences = _action_sequences()
    longest = max(map(len, sequences)) + 1  # one step more to come to rest
    actions = np.array([ids + [0] * (longest - len(ids)) for ids in sequences])  # (N, T)
    time = np.array([len(ids) for ids in sequences], dtype=np.float64)
    centres, angles = _roll_out(actions, TABLE.speeds[speed], TABLE.spins[spin])
    ahead = _ahead(angles)  # (N, K, 2)
    right = np.stack((ahead[..., 1], -ahead[..., 0]), axis=-1)
    end = angles[:, -1], ahead[:, -1], right[:, -1]
    return MotionTable(actions[:, 0], time, centres, centres + HELD_DISTANCE * ahead, *end)


def _action_sequences() -> list[list[int]]:
    return [
        [first] * n + [second] * m
        for first in range(OPEN_ACTIONS)
        for n in TABLE.first_steps
        for second in range(OPEN_ACTIONS)
        for m in TABLE.second_steps
        if (first != second) == (m > 0)
    ]


def _roll_out(actions: Ints, speed: float, spin: float) -> tuple[Floats, Floats]:
    """Centres (N, K, 2) and angles (N, K) on the paths of action sequences (N, T)."""
    aims = np.array([0.0, DRIVE_STEP, -BACK_STEP])[actions % 3]
    turn_aims = np.array([0.0, TURN_STEP, -TURN_STEP])[actions // 3 % 3]
    spins, angle = np.full(len(actions), spin), np.zeros(len(actions))
    centre, velocity = np.zeros((len(actions), 2)), np.zeros((len(actions), 2))
    velocity[:, 1] = speed
    centres, angles = [], []
    for step in range(actions.shape[1]):
        turn, spins = _turn(spins, turn_aims[:, step])
        before, middle, after = (_ahead(angle + share * turn) for share in (0.0, 0.5, 1.0))
        faster = _accelerate(velocity, aims[:, step, None] * middle)
        centre = centre + 0.5 * (velocity + faster) + MODEL.pivot * (before - after)
        angle, velocity = angle + turn, faster
        if step % TABLE.stride == TABLE.stride - 1 or step == actions.shape[1] - 1:
            centres.append(centre)
            angles.append(angle)
    return np.stack(centres, axis=1), np.stack(angles, axis=1)


def _accelerate(velocity: Floats, aim: Floats) -> Floats:
    """The velocity (N, 2) after a step of the drive towards `aim` and of the block's friction."""
    wanted = aim + _capped_share(aim, MODEL.drag) * aim - velocity
    driven = velocity + _capped_share(wanted, MODEL.drive) * wanted
    return driven * (1.0 - _capped_share(driven, MODEL.drag))


def _capped_share(vector: Floats, limit: float) -> Floats:
    """The factors (N, 1) that cap the length of vectors (N, 2)."""
    length = np.hypot(vector[:, :1], vector[:, 1:])
    share: Floats = np.minimum(1.0, limit / np.maximum(length, 1e-9))
    return share


def _ahead(angle: Floats) -> Floats:
    return np.stack((-np.sin(angle), np.cos(angle)), axis=-1)


def _turn(spin: Floats, aim: Floats) -> tuple[Floats, Floats]:
    """The angle turned in a control step, and the turning after it."""
    increased = spin + np.clip(aim - spin, -MODEL.spin_up, MODEL.spin_up)
    reversed_ = aim * spin < 0
    after = np.where(reversed_, 0.5 * aim, np.where(aim == 0, 0.0, increased))
    stopping = reversed_ | (aim == 0)
    turned = np.where(stopping, MODEL.spin_stop * spin, 0.375 * spin + 0.625 * increased)
    return turned, after
