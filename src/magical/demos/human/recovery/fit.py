"""Fitting poses to recorded frames: logistic regression on which side of edges the pixels lie.

A statement of `render.edges.Edges` with margin m holds with probability 1 / (1 + exp(-m / softness)).
The likelihood of all statements in both views is maximised, first softly over a wide band around
the edges, then ever more sharply. The pixels of an outline sample its edge at hundreds of different
distances, so that poses follow to about a hundredth of a pixel.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from magical.render.edges import EdgeFinder, Edges, Labels
from magical.scene import Scene, Shape, View
from magical.scene.poses import EYES, FIRST_BLOCK, ROBOT

MAX_STEP = 0.1  # units or radians in one iteration
RIDGE = 1.0  # per square unit or radian: keeps what no pixel determines
ROBOT_ROWS = range(FIRST_BLOCK)

Bodies = NDArray[np.float64]  # (5 + blocks, 3), rows as in `Poses`


class Stage(NamedTuple):
    """Some iterations at one softness."""

    softness: float  # pixels
    iterations: int
    sharp: bool = True  # Newton's method, for poses that are nearly right

    @property
    def band(self) -> float:
        """Pixels around edges that matter."""
        return 6.0 * self.softness + 0.2


COARSE = (Stage(2.5, 4, sharp=False),)
MIDDLE = (Stage(0.8, 3, sharp=False),)
FINE = (Stage(0.3, 2), Stage(0.1, 2), Stage(0.03, 3))


@dataclass(frozen=True, slots=True)
class Fit:
    """Fitted poses, and how well the pixels determine them."""

    bodies: Bodies
    deviations: Bodies  # standard deviations of x, y and angle; 0 where they were not fitted


class PoseFitter:
    """Fits poses of one scene's bodies to frames in several views of one moment."""

    def __init__(self, scene: Scene) -> None:
        self._finders = {view: EdgeFinder(scene, view) for view in View}
        self._round = [block.shape == Shape.CIRCLE for block in scene.blocks]

    def label(self, frames: Mapping[View, NDArray[np.uint8]]) -> dict[View, Labels]:
        """What `fit` takes, of frames (384, 384, 3)."""
        return {view: self._finders[view].label(frame) for view, frame in frames.items()}

    def fit(
        self,
        bodies: Bodies,
        labels: Mapping[View, Labels],
        free: Sequence[int],
        stages: Sequence[Stage],
    ) -> Fit:
        """Fit the poses in the rows `free` from a first guess of all."""
        columns = self._columns(free)
        bodies = bodies.copy()
        hessian = np.eye(len(columns))
        for stage in stages:
            for _ in range(stage.iterations):
                edges = {v: self._finders[v].find(bodies, labels[v], stage.band) for v in labels}
                gradient, hessian = _normal_equations(edges, columns, stage.softness, stage.sharp)
                step = np.clip(np.linalg.solve(hessian, gradient), -MAX_STEP, MAX_STEP)
                for (row, axis), value in zip(columns, step.tolist(), strict=True):
                    bodies[row, axis] += value
                bodies[EYES, :2] = bodies[ROBOT, :2]
        deviations = np.zeros_like(bodies)
        for (row, axis), value in zip(columns, np.sqrt(np.diag(np.linalg.inv(hessian))), strict=True):
            deviations[row, axis] = value
        return Fit(bodies, deviations)

    def _columns(self, free: Sequence[int]) -> list[tuple[int, int]]:
        """The row and axis of every unknown."""
        columns = []
        for row in free:
            is_eye = row in range(EYES.start, EYES.stop)
            is_disc = row >= FIRST_BLOCK and self._round[row - FIRST_BLOCK]
            columns += [(row, axis) for axis in ((2,) if is_eye else (0, 1) if is_disc else (0, 1, 2))]
        return columns


def _normal_equations(
    edges: Mapping[View, Edges], columns: Sequence[tuple[int, int]], softness: float, sharp: bool
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The log likelihood's gradient and its negated curvature, or a bound of that."""
    rows = 3 * (1 + max(row for row, _ in columns))
    gradient, hessian = np.zeros(rows), np.zeros((rows, rows))
    for view, found in edges.items():
        scaled = np.clip(found.margin / softness, -40.0, 40.0)
        wrong = 1.0 / (1.0 + np.exp(scaled))
        if sharp:
            weights = wrong * (1.0 - wrong)
        else:
            # Jaakkola and Jordan's quadratic bound: every step raises the likelihood.
            weights = np.where(np.abs(scaled) < 1e-3, 0.25, (0.5 - wrong) / scaled)
        _accumulate(found, wrong / softness, weights / softness**2, view, gradient, hessian)
    chosen = [3 * row + axis for row, axis in columns]
    return gradient[chosen], hessian[np.ix_(chosen, chosen)] + RIDGE * np.eye(len(chosen))


def _accumulate(
    edges: Edges,
    slopes: NDArray[np.float64],
    weights: NDArray[np.float64],
    view: View,
    gradient: NDArray[np.float64],
    hessian: NDArray[np.float64],
) -> None:
    """Add one view's statements, one pair of bodies at a time."""
    bodies = len(gradient) // 3
    keys = edges.anchor * bodies + edges.turn
    order = np.argsort(keys, kind="stable")
    keys = keys[order]
    starts = [0, *(np.flatnonzero(np.diff(keys)) + 1).tolist(), len(keys)]
    for start, stop in zip(starts[:-1], starts[1:], strict=True):
        rows = order[start:stop]
        anchor, turn = int(edges.anchor[rows[0]]), int(edges.turn[rows[0]])
        columns, parts = [], []
        if 0 <= anchor < bodies:
            columns += [3 * anchor, 3 * anchor + 1, 3 * anchor + 2]
            parts += [edges.position[rows], edges.angles[rows, :1]]
        if turn != anchor and turn < bodies:
            columns += [3 * turn + 2]
            parts += [edges.angles[rows, 1:2]]
        if view == View.EGO:
            camera = [3 * ROBOT, 3 * ROBOT + 1, 3 * ROBOT + 2]
            moved = [-edges.position[rows], edges.angles[rows, 2:]]
            if anchor == ROBOT:
                parts[0], parts[1] = parts[0] + moved[0], parts[1] + moved[1]
            else:
                columns += camera
                parts += moved
        if columns:
            jacobian = np.concatenate(parts, axis=1)
            gradient[columns] += slopes[rows] @ jacobian
            hessian[np.ix_(columns, columns)] += jacobian.T @ (weights[rows, None] * jacobian)
