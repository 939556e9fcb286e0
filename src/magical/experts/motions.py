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
_PULL, _DRAG = 0.028, 0.0145  # units: of the drive, and of the held block on the floor
_SPIN_UP = 0.085  # rad
_SPIN_STOP = 0.33  # share of the present turning that is still turned when it stops

PIVOT = 0.06  # units ahead of the robot's centre about which it turns with a block
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
    ahead = _ahead(angle)  # (N, K, 2)
    right = np.stack((ahead[..., 1], -ahead[..., 0]), axis=-1)
    end = angle[:, -1], ahead[:, -1], right[:, -1]
    return Table(padded[:, 0], time, at, at + HOLD * ahead, *end)


def _roll_out(orders: NDArray[np.intp], speed: float, spin: float) -> tuple[Floats, Floats]:
    """Centres (N, K, 2) and headings (N, K) on the ways of orders (N, T) of actions."""
    speeds = np.array([0.0, STEP, STEP * DRIVE_SPEED_BACK / DRIVE_SPEED_FORWARD])[orders % 3]
    spins = np.array([0.0, TAP, -TAP])[orders // 3 % 3]
    w, angle = np.full(len(orders), spin), np.zeros(len(orders))
    at, velocity = np.zeros((len(orders), 2)), np.zeros((len(orders), 2))
    velocity[:, 1] = speed
    ways, angles = [], []
    for step in range(orders.shape[1]):
        turn, w = _turn(w, spins[:, step])
        before, middle, after = (_ahead(angle + share * turn) for share in (0.0, 0.5, 1.0))
        faster = _pull(velocity, speeds[:, step, None] * middle)
        at = at + 0.5 * (velocity + faster) + PIVOT * (before - after)
        angle, velocity = angle + turn, faster
        if step % _STRIDE == _STRIDE - 1 or step == orders.shape[1] - 1:
            ways.append(at)
            angles.append(angle)
    return np.stack(ways, axis=1), np.stack(angles, axis=1)


def _pull(velocity: Floats, aim: Floats) -> Floats:
    """The velocity (N, 2) after a step of the drive's pull towards `aim`, and of drag."""
    wanted = aim + _capped(aim, _DRAG) * aim - velocity
    pulled = velocity + _capped(wanted, _PULL) * wanted
    return pulled * (1.0 - _capped(pulled, _DRAG))


def _capped(vector: Floats, most: float) -> Floats:
    """The share (N, 1) of each vector (N, 2) whose length is at most `most`."""
    length = np.hypot(vector[:, :1], vector[:, 1:])
    share: Floats = np.minimum(1.0, most / np.maximum(length, 1e-9))
    return share


def _ahead(angle: Floats) -> Floats:
    return np.stack((-np.sin(angle), np.cos(angle)), axis=-1)


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
