"""How robot and held block move, as a rule of thumb, and all short motions rolled out under it.

The model knows top speeds and how fast they are reached, nothing of contacts; a pair of short
motions is an action kept up for a few control steps, then another. Each skill picks, at every
control step, the pair after which its goal is nearest in time, and takes the pair's first action.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from magical.scene.constants import (
    BLOCK_SIZE,
    CONTROL_RATE,
    DRIVE_SPEED_BACK,
    DRIVE_SPEED_FORWARD,
    ROBOT_RADIUS,
    TURN_MAX_BIAS,
)

Floats = NDArray[np.float64]

TAP = TURN_MAX_BIAS / CONTROL_RATE  # rad: one control step of turning
STEP = DRIVE_SPEED_FORWARD / CONTROL_RATE  # units: one control step of driving
HOLD = ROBOT_RADIUS + BLOCK_SIZE + 0.015  # units from the robot's centre to a held block's

# Accelerations with a held block, with a control step as the unit of time.
_SPEED_UP, _SLOW_DOWN = 0.013, 0.04  # units
_SPIN_UP = 0.12  # rad
_SPIN_STOP = 0.33  # share of the present turning that is still turned when it stops

_FIRST = (1, 2, 3, 5)  # control steps of the first motion of a pair
_SECOND = (0, 1, 2, 4)  # and of the second
_STRIDE = 2  # control steps between the points of a way that are checked for obstacles
_SPEEDS = (-0.06, 0.0, 0.05, 0.1)  # units per control step: initial speeds that have a table
_SPINS = (-0.25, 0.0, 0.25)  # rad per control step: initial turning that has
ACTIONS_TRIED = 9  # those with open fingers; those with closed fingers follow in their order


@dataclass(frozen=True, slots=True)
class Table:
    """Pairs of motions in the frame the robot starts from: N pairs, K points of each way."""

    first: NDArray[np.intp]  # (N,) action ids with open fingers, in ascending order
    time: Floats  # (N,) control steps
    robot: Floats  # (N, K, 2) the robot's centre on the way; the last is the end
    block: Floats  # (N, K, 2) where a held block would be
    turned: Floats  # (N,) rad
    ahead: Floats  # (N, 2) unit vector ahead at the end
    right: Floats  # (N, 2) and to the right


def table_for(speed: float, spin: float) -> Table:
    """The pairs from the initial speed (units / s) and turning (rad / s) nearest to the given."""
    return _table(_nearest(_SPEEDS, speed), _nearest(_SPINS, spin))


def _nearest(values: Sequence[float], per_second: float) -> int:
    per_step = per_second / CONTROL_RATE
    return min(range(len(values)), key=lambda i: abs(values[i] - per_step))


@cache
def _table(speed: int, spin: int) -> Table:
    pairs = [
        (a, n, b, m)
        for a in range(ACTIONS_TRIED)
        for n in _FIRST
        for b in range(ACTIONS_TRIED)
        for m in _SECOND
        if (a != b) == (m > 0)
    ]
    orders = [[a] * n + [b] * m for a, n, b, m in pairs]
    longest = max(map(len, orders)) + 1  # one step more to come to rest
    padded = np.array([ids + [0] * (longest - len(ids)) for ids in orders])  # (N, T)
    time = np.array([len(ids) for ids in orders], dtype=np.float64)
    at, angle = _roll_out(padded, _SPEEDS[speed], _SPINS[spin])
    ahead = np.stack((-np.sin(angle), np.cos(angle)), axis=-1)  # (N, K, 2)
    right = np.stack((ahead[..., 1], -ahead[..., 0]), axis=-1)
    end = angle[:, -1], ahead[:, -1], right[:, -1]
    return Table(padded[:, 0], time, at, at + HOLD * ahead, *end)


def _roll_out(orders: NDArray[np.intp], speed: float, spin: float) -> tuple[Floats, Floats]:
    """Centres (N, K, 2) and headings (N, K) on the ways of orders (N, T) of actions."""
    speeds = np.array([0.0, STEP, STEP * DRIVE_SPEED_BACK / DRIVE_SPEED_FORWARD])[orders % 3]
    spins = np.array([0.0, TAP, -TAP])[orders // 3 % 3]
    v, w = np.full(len(orders), speed), np.full(len(orders), spin)
    at, angle = np.zeros((len(orders), 2)), np.zeros(len(orders))
    ways, angles = [], []
    for step in range(orders.shape[1]):
        faster = _towards(v, speeds[:, step], _SPEED_UP, _SLOW_DOWN)
        turn, w = _turn(w, spins[:, step])
        middle = angle + 0.5 * turn
        along = 0.5 * (v + faster)
        at = at + np.stack((-np.sin(middle) * along, np.cos(middle) * along), axis=-1)
        angle, v = angle + turn, faster
        if step % _STRIDE == _STRIDE - 1 or step == orders.shape[1] - 1:
            ways.append(at)
            angles.append(angle)
    return np.stack(ways, axis=1), np.stack(angles, axis=1)


def _towards(value: Floats, aim: Floats, up: float, down: float) -> Floats:
    slowing = (np.abs(aim) < np.abs(value)) | (aim * value < 0)
    limit = np.where(slowing, down, up)
    return value + np.clip(aim - value, -limit, limit)


def _turn(spin: Floats, aim: Floats) -> tuple[Floats, Floats]:
    """What is turned in a control step, and the turning after it."""
    on = spin + np.clip(aim - spin, -_SPIN_UP, _SPIN_UP)
    against = aim * spin < 0
    after = np.where(against, 0.5 * aim, np.where(aim == 0, 0.0, on))
    turned = np.where(against | (aim == 0), _SPIN_STOP * spin, 0.375 * spin + 0.625 * on)
    return turned, after


def reach_time(distance: float, angle: float) -> float:
    """About how many control steps a drive of `distance` with turns of `angle` rad takes."""
    return 2.0 + distance / STEP + math.fabs(angle) / TAP
