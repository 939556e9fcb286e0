"""How the robot moves, learned from demonstrations: free, and with a block between its fingers.

In a control step, the robot keeps a share of its speed, and of its turning, and gains a certain
amount from the action. Both are fitted to parsed frames, with a prior from other tasks (`PRIOR`),
so that ten demonstrations are enough; the fit is robust, so contacts do not spoil it.
"""

from collections.abc import Callable, Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from magical.experts.geometry import wrap_angle
from magical.scene import to_continuous
from magical_goals.objects.control import GRIP
from magical_goals.objects.data import ParsedDemonstration

MOST = 0.9  # share of the demonstrated grasps within the limits
SPEEDS, SPINS = np.array([-0.1, 0.0, 0.1]), np.array([-0.3, 0.0, 0.3])  # units, rad per step
RESIDUAL = 0.05  # share of the largest speed: larger residuals are likely contacts
HELD_UP = 0.01  # units per step: a robot that drives but stays slower is held up

Floats = NDArray[np.float64]


class Motion(NamedTuple):
    """The effect of actions on speeds in a control step; row 0: free, row 1: with a block."""

    drive: Floats  # (2, 3) share of the speed that is kept; units gained backward, forward
    turn: Floats  # (2, 2) share of the turning that is kept; rad gained to the left
    grasp: Floats  # (3,) where blocks lie when fingers close, units: aside; nearest, farthest ahead

    @property
    def speeds(self) -> Floats:
        """Top speeds (2, 3): units per step backward and forward, rad per step."""
        gained = np.column_stack([-self.drive[:, 1], self.drive[:, 2], self.turn[:, 1]])
        kept = np.column_stack([self.drive[:, 0], self.drive[:, 0], self.turn[:, 0]])
        return gained / (1.0 - kept)


PRIOR = Motion(
    np.array([[0.60, -0.037, 0.041], [0.72, -0.021, 0.022]]),
    np.array([[0.34, 0.21], [0.42, 0.155]]),
    np.zeros(3),
)  # from ten scripted demonstrations of each of twelve training tasks of the generated suite


class _Steps(NamedTuple):
    """S steps of demonstrations, starting with each one's second."""

    before: Floats  # (S, 2) units ahead, rad to the left in the previous step
    after: Floats  # (S, 2) the same in this step
    commands: Floats  # (S, 3) drive, turn and grip of this step's action
    carried: NDArray[np.bool_]  # (S,) whether a block was carried


def fit_motion(demonstrations: Sequence[ParsedDemonstration]) -> Motion:
    """Fit the motion that demonstrations show, relying on `PRIOR` for what they do not show."""
    parts = map(_steps, demonstrations)
    steps = _Steps(*map(np.concatenate, zip(*parts, strict=True)))
    models = [_fit(steps, row) for row in (0, 1)]
    drive, turn = map(np.stack, zip(*models, strict=True))
    grasps = np.concatenate(list(map(_grasps, demonstrations)))
    grasps = grasps if len(grasps) else np.array([[0.0, GRIP]])
    nearest, farthest = np.quantile(grasps[:, 1], (1.0 - MOST, MOST))
    aside = np.quantile(np.abs(grasps[:, 0]), MOST)
    return Motion(drive, turn, np.array([aside, nearest, farthest]))


def _fit(steps: _Steps, row: int) -> tuple[Floats, Floats]:
    """Fit the coefficients of drive (3,) and turn (2,), free or with a block."""
    rows = steps.carried == bool(row)
    (speed, spin), (drive, turn) = steps.before[rows].T, steps.commands[rows, :2].T
    ahead, to_left = steps.after[rows].T
    moved = (drive == 0) | (np.maximum(np.abs(speed), np.abs(ahead)) > HELD_UP)
    inputs = _drive_inputs(speed[moved], drive[moved])
    return (
        _robust(inputs, ahead[moved], PRIOR.drive[row], SPEEDS, _drive_inputs),
        _robust(_turn_inputs(spin, turn), to_left, PRIOR.turn[row], SPINS, _turn_inputs),
    )


def _drive_inputs(speed: Floats, drive: Floats) -> Floats:
    return np.column_stack([speed, drive < 0, drive > 0])


def _turn_inputs(spin: Floats, turn: Floats) -> Floats:
    return np.column_stack([spin, turn])


def _robust(
    inputs: Floats, outputs: Floats, prior: Floats, speeds: Floats, make: Callable[..., Floats]
) -> Floats:
    """Fit coefficients; the prior counts as one step at each of the speeds with each command."""
    assumed = make(*np.array(list(product(speeds, (-1.0, 0.0, 1.0)))).T)
    inputs = np.vstack([inputs, assumed])
    outputs = np.append(outputs, assumed @ prior)
    found = least_squares(
        lambda c: inputs @ c - outputs, prior, loss="cauchy", f_scale=RESIDUAL * speeds.max()
    )
    coefficients: Floats = found.x
    return coefficients


def _steps(shown: ParsedDemonstration) -> _Steps:
    robot, actions = shown.parsed.robot, shown.trajectory.actions
    moved = robot_steps(robot[:-1], robot[1:])
    carried = np.zeros(len(actions), np.bool_)
    for _, first, last in shown.carries:
        carried[first : last + 1] = True
    return _Steps(moved[:-1], moved[1:], to_continuous(actions)[1:], carried[1:])


def _grasps(shown: ParsedDemonstration) -> Floats:
    """Where carried blocks lay, to the right and ahead (G, 2), when the fingers began to close."""
    _, trajectory, parsed = shown
    closed = (to_continuous(trajectory.actions)[:, 2] > 0) & trajectory.is_intended
    found = []
    for block, first, last in shown.carries:
        if closed[first : last + 1].any():
            step = first + int(closed[first : last + 1].argmax())
            while step and closed[step - 1]:
                step -= 1
            found.append(to_robot(parsed.robot[step], parsed.blocks[step, block]))
    return np.reshape(found, (-1, 2))


def robot_steps(before: Floats, after: Floats) -> Floats:
    """The motion (..., 2) between poses (..., 3): units ahead, rad to the left."""
    ahead = to_robot(before, after[..., :2])[..., 1]
    return np.stack([ahead, wrap_angle(after[..., 2] - before[..., 2])], axis=-1)


def to_robot(poses: Floats, points: Floats) -> Floats:
    """Points (..., 2) as seen from poses (..., 3): to the right, ahead."""
    x, y = np.moveaxis(points - poses[..., :2], -1, 0)
    cos, sin = np.cos(poses[..., 2]), np.sin(poses[..., 2])
    return np.stack([x * cos + y * sin, y * cos - x * sin], axis=-1)


def from_robot(poses: Floats, points: Floats) -> Floats:
    """The inverse of `to_robot`."""
    right, ahead = np.moveaxis(points, -1, 0)
    cos, sin = np.cos(poses[..., 2]), np.sin(poses[..., 2])
    offset = np.stack([right * cos - ahead * sin, right * sin + ahead * cos], axis=-1)
    found: Floats = poses[..., :2] + offset
    return found
