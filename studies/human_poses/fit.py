"""Fitting poses to recorded frames: logistic regression on which side of edges pixels lie.

A statement in `edges.Edges` with margin m holds with probability 1 / (1 + exp(-m / s)). The joint
likelihood of the statements from all views is maximised by Newton's method, first with a softness s
of about one pixel and then with smaller ones. Its curvature at the end gives the uncertainty.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from edges import EdgeFinder, Edges, Labels
from numpy.typing import NDArray
from outlines import SIZE, VIEW_WIDTH

from magical.scene import EYES, FIRST_BLOCK, ROBOT, Scene, Shape, View

PIXEL = VIEW_WIDTH / SIZE  # units
MAX_STEP = 0.1  # units or radians per iteration
CONVERGED = 0.3  # times the softness: a smaller step ends a stage
RIDGE = 1.0  # per square unit or square radian: regularises poses that no pixel determines

Bodies = NDArray[np.float64]  # (5 + blocks, 3), the poses in the rows of `Poses`
Array = NDArray[np.float64]


class Stage(NamedTuple):
    """Iterations with one softness."""

    softness: float  # pixels
    iterations: int  # at most
    bounded: bool = False  # use steps that always improve the fit, for poses that are pixels off

    @property
    def band(self) -> float:
        """Largest distance from an edge, in pixels, at which a pixel matters."""
        return 6.0 * self.softness + 0.2


NEAR_STAGES = (Stage(0.8, 3, bounded=True), Stage(0.3, 2), Stage(0.1, 2), Stage(0.03, 4))
# For initial guesses that are up to 15 pixels off.
FAR_STAGES = (Stage(2.5, 8, bounded=True), *NEAR_STAGES)


class Fit(NamedTuple):
    """Fitted poses, and how well the pixels determine them."""

    bodies: Bodies
    deviations: Bodies  # standard deviations of x, y and angle; 0 if not fitted


class PoseFitter:
    """Fits the poses of one scene's bodies to the frames of one time step in both views."""

    def __init__(self, scene: Scene) -> None:
        self._finders = {view: EdgeFinder(scene, view) for view in View}
        self.discs = [  # rows of round blocks, whose angles cannot be seen
            FIRST_BLOCK + i for i, block in enumerate(scene.blocks) if block.shape == Shape.CIRCLE
        ]

    def label(self, frames: Mapping[View, NDArray[np.uint8]]) -> dict[View, Labels]:
        """The labels that `fit` takes, from frames (384, 384, 3) in both views."""
        return {view: self._finders[view].label(frames[view]) for view in View}

    def fit(
        self,
        guess: Bodies,
        labels: Mapping[View, Labels],
        free: Sequence[int],
        stages: Sequence[Stage] = NEAR_STAGES,
    ) -> Fit:
        """Fit the poses in the rows `free`; a round block's angle, which cannot be seen, stays.

        `guess` has initial poses of the free rows, and fixed poses of the others.
        """
        unknown, wanted = np.zeros(guess.shape, np.bool_), np.zeros(len(guess), np.bool_)
        unknown[list(free)] = wanted[list(free)] = True
        unknown[EYES, :2] = unknown[self.discs, 2] = False
        is_position = np.nonzero(unknown)[1] < 2
        bodies, curvature = guess.copy(), np.eye(len(is_position))
        for stage in stages:
            for _ in range(stage.iterations):
                edges = {
                    view: finder.find(bodies, labels[view], stage.band, wanted)
                    for view, finder in self._finders.items()
                }
                slope, curvature = _likelihood(edges, unknown, stage)
                step = np.clip(np.linalg.solve(curvature, slope), -MAX_STEP, MAX_STEP)
                _move(bodies, unknown, step)
                shift = np.abs(step[is_position]).max(initial=0.0)
                if shift < CONVERGED * stage.softness * PIXEL:
                    break
        deviations = np.zeros_like(bodies)
        _move(deviations, unknown, np.sqrt(np.diag(np.linalg.inv(curvature))))
        return Fit(bodies, deviations)


def _move(bodies: Bodies, unknown: NDArray[np.bool_], step: Array) -> None:
    bodies[unknown] += step
    bodies[EYES, :2] = bodies[ROBOT, :2]


def _likelihood(
    edges: Mapping[View, Edges], unknown: NDArray[np.bool_], stage: Stage
) -> tuple[Array, Array]:
    """The gradient of the log-likelihood, and its negated Hessian or a bound on that."""
    slope, curvature = np.zeros(unknown.size), np.zeros((unknown.size, unknown.size))
    for view, found in edges.items():
        scaled = np.clip(found.margin / stage.softness, -40.0, 40.0)
        wrong = 1.0 / (1.0 + np.exp(scaled))
        weights = _bounds(scaled, wrong) if stage.bounded else wrong * (1.0 - wrong)
        weights /= stage.softness**2
        for columns, rows, jacobian in _jacobians(found, view):
            slope[columns] += wrong[rows] @ jacobian / stage.softness
            block = jacobian.T @ (weights[rows, None] * jacobian)
            curvature[np.ix_(columns, columns)] += block
    chosen = np.flatnonzero(unknown)
    ridge = RIDGE * np.eye(len(chosen))
    return slope[chosen], curvature[np.ix_(chosen, chosen)] + ridge


def _bounds(scaled: Array, wrong: Array) -> Array:
    """Jaakkola and Jordan's bound on the curvature (Statistics and Computing 10, 2000)."""
    away = np.where(np.abs(scaled) < 1e-3, 1.0, scaled)
    return np.where(away == scaled, (0.5 - wrong) / away, 0.25)


def _jacobians(edges: Edges, view: View) -> Iterator[tuple[list[int], NDArray[np.int64], Array]]:
    """The derivatives of the margins, one group of statements about the same bodies at a time.

    Yields:
        The columns 3 * row + axis, the statements (n,), and the derivatives (n, columns).
    """
    pairs = 256 * edges.anchor + edges.turn
    order = np.argsort(pairs, kind="stable")
    for rows in np.split(order, np.flatnonzero(np.diff(pairs[order])) + 1):
        if not len(rows):
            continue
        anchor, turn = int(edges.anchor[rows[0]]), int(edges.turn[rows[0]])
        x, y = edges.x[rows], edges.y[rows]
        parts: dict[int, Array] = {}
        if anchor >= 0:
            parts = {3 * anchor: x, 3 * anchor + 1: y, 3 * anchor + 2: edges.anchor_angle[rows]}
        if turn != anchor:
            parts[3 * turn + 2] = edges.turn_angle[rows]
        if view == View.EGO:  # the camera moves with the robot
            for axis, change in enumerate((-x, -y, edges.camera_angle[rows])):
                column = 3 * ROBOT + axis
                parts[column] = parts[column] + change if column in parts else change
        yield list(parts), rows, np.stack(list(parts.values()), axis=1)
