"""Recovers the poses of the published human demonstrations from their frames.

    python studies/human_poses/recover.py SRC OUT [--workers N]

SRC is a folder with the published files (`magical demos download --keep SRC --out frames`). OUT
becomes a dataset of the demonstrations whose poses explain every frame, in the files' order, with
estimated velocities. `metadata["recovery"]` says how well the poses are known. A file that OUT
holds already is skipped.
"""

import argparse
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from fit import FAR_STAGES, Bodies, Fit, PoseFitter
from numpy.typing import NDArray
from outlines import VIEW_WIDTH

from magical.demos import Dataset, DatasetWriter, Trajectory
from magical.demos.human import FullFrames, find_published, read_demonstration
from magical.physics import Simulation
from magical.processes import map_in_processes
from magical.render import Renderer
from magical.scene import EYES, FINGERS, FIRST_BLOCK, POINTS, ROBOT, Poses, Scene, View
from magical.scene.constants import BLOCK_SIZE, CONTROL_RATE, RAW_FRAME_SIZE, STAR_OUTER_RADIUS

LIMIT = 0.005  # share of wrong pixels in one frame, above which poses are not accepted
TOLERANCE = 8  # grey levels: pixels that differ by more in any channel are wrong
RETRY = 1e-3  # share of wrong pixels above which other initial guesses are tried
NEARBY = 0.03  # units around a block within which wrong pixels may be due to it
SIGNIFICANT = 3.0  # standard deviations: a block that seems to have moved less counts as at rest
UNSEEN = 0.1  # units or radians: standard deviation of a pose that the pixels do not determine
GRID = 2.0**-17  # units or radians: rounding of the poses, far below their uncertainty
PRECISION = 1e-3  # units or radians: smaller differences may be errors of the recovered poses
_GROUPS = {"robot": slice(ROBOT, ROBOT + 1), "fingers": FINGERS, "eyes": EYES}
_GROUPS |= {"blocks": slice(FIRST_BLOCK, None)}
_SHAPE = (RAW_FRAME_SIZE, RAW_FRAME_SIZE, 3)
_REACH = max(BLOCK_SIZE, STAR_OUTER_RADIUS) + NEARBY  # units

ViewFrames = Mapping[View, NDArray[np.uint8]]  # (384, 384, 3) in both views
Mask = NDArray[np.bool_]  # (384, 384)


def main() -> None:
    parser = argparse.ArgumentParser(description=str(__doc__).partition("\n")[0])
    parser.add_argument("source", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--workers", type=int, default=1)
    args = parser.parse_args()
    writer = DatasetWriter(args.out)
    known = {entry.name for entry in Dataset.open(args.out).entries}
    files = [file for file in find_published(args.source) if file.name not in known]
    outcomes = map_in_processes(recovered, files, args.workers)
    for file, found in zip(files, outcomes, strict=True):
        if isinstance(found, Trajectory):
            writer.append(found)
        print(f"{file.name}: {found}", flush=True)


def recovered(file: Path) -> Trajectory | str:
    """The trajectory of the recovered poses, or why there is none."""
    demonstration, frames = read_demonstration(file)
    recovery = recover(demonstration, frames)
    if recovery.problem:
        return recovery.problem
    found = {"recorded_score": demonstration.published_code_score, "recovery": recovery.metadata()}
    return Trajectory.from_bodies(
        demonstration.env_id,
        demonstration.scene,
        demonstration.actions,
        recovery.bodies,
        demonstrator="human",
        metadata={**demonstration.metadata, **found},
    )


@dataclass(frozen=True, slots=True)
class Recovery:
    """The poses recovered from the first N frames of a recording."""

    bodies: NDArray[np.float64]  # (N, 5 + blocks, 6); velocities are estimates
    deviations: NDArray[np.float64]  # (N, 5 + blocks, 3): standard deviations; 0 if unchanged
    wrong: NDArray[np.float64]  # (N,): share of pixels that differ by more than `TOLERANCE`
    unseen: int  # number of poses kept because no pixel determined them, over all frames
    problem: str | None = None  # why the poses must not be used

    def metadata(self) -> dict[str, Any]:
        """Plain data for a trajectory's metadata."""
        wrong = [round(share, 7) for share in self.wrong.tolist()]
        return {
            "tolerance": TOLERANCE,
            "wrong_pixels": wrong,
            "largest_wrong_pixels": max(wrong),
            "deviations": {name: self._deviation(rows) for name, rows in _GROUPS.items()},
            "unseen_poses": self.unseen,
        }

    def _deviation(self, rows: slice) -> dict[str, float]:
        """95th percentiles over the fitted values, in units and radians."""
        fitted = self.deviations[:, rows]
        parts = {"position": fitted[..., :2].max(axis=-1), "angle": fitted[..., 2]}
        return {
            name: round(float(np.percentile(part[part > 0], 95)), 7) if part.any() else 0.0
            for name, part in parts.items()
        }


def recover(demonstration: Trajectory, frames: FullFrames) -> Recovery:
    """Recover the poses of all bodies at every time step, up to a frame that no poses explain."""

    def at(time: int) -> dict[View, NDArray[np.uint8]]:
        return {view: of_view[time] for view, of_view in frames.items()}

    tracker = Tracker(demonstration.scene)
    moments = [tracker.start(at(0))]
    for time, action in enumerate(demonstration.actions.tolist(), 1):
        if moments[-1].wrong > LIMIT:
            break
        moments.append(tracker.follow(action, at(time)))
    wrong = np.array([moment.wrong for moment in moments])
    return Recovery(
        np.stack([moment.bodies for moment in moments]),
        np.stack([moment.deviations for moment in moments]),
        wrong,
        sum(moment.unseen for moment in moments),
        _problem(wrong),
    )


class PoseFollower:
    """A simulation that is reset to recovered poses after every control step."""

    def __init__(self, scene: Scene) -> None:
        self._simulation = Simulation(scene)
        self.states = self._simulation.read()  # poses and velocities, (5 + blocks, 6)

    def predict(self, action: int) -> Bodies:
        """Simulate one control step from the current poses and velocities; returns the poses."""
        self._simulation.write(self.states)
        self._simulation.step(action)
        self._predicted = self._simulation.read()
        return self._predicted[:, :3].copy()

    def correct(self, bodies: Bodies) -> None:
        """Continue from the recovered poses; bodies that did not move are at rest."""
        still = (bodies == self.states[:, :3]).all(axis=1)
        states = self._predicted.copy()
        lacking = bodies - states[:, :3]
        wrong = np.abs(lacking).max(axis=1) > PRECISION
        states[wrong, 3:] += CONTROL_RATE * lacking[wrong]
        states[still, 3:] = 0.0
        states[:, :3] = bodies
        self.states = states


def _problem(wrong: NDArray[np.float64]) -> str | None:
    if wrong[-1] <= LIMIT:
        return None
    found = f"{wrong[-1]:.2%} of its pixels differ, at most {LIMIT:.2%} expected"
    if len(wrong) == 1:
        return f"the recording does not start in the Demo scene: {found}"
    return f"no poses explain the frames of time step {len(wrong) - 1}: {found}"


@dataclass(frozen=True, slots=True)
class Moment:
    """The poses recovered from the frames of one time step."""

    bodies: NDArray[np.float64]  # poses and velocities, in the rows of `Poses`, (5 + blocks, 6)
    deviations: Bodies  # standard deviations; 0 for poses that were kept
    wrong: float  # share of pixels in both views that differ by more than `TOLERANCE`
    unseen: int  # bodies that kept their poses because the pixels do not determine them


class Tracker:
    """Recovers the poses of one episode, which starts at rest in `scene`.

    The initial guess for each time step is simulated from the previous one. A body about which the
    pixels say nothing new keeps its pose.
    """

    def __init__(self, scene: Scene) -> None:
        self._fitter = PoseFitter(scene)
        # The human demonstrations were recorded with another graphics driver.
        self._renderers = {
            view: Renderer(scene, view, RAW_FRAME_SIZE, 1, whole_dashes=False) for view in View
        }
        self._rendered = np.empty(_SHAPE, np.uint8)
        self._follower = PoseFollower(scene)
        self._bodies = Poses.at_rest(scene).bodies
        self._frames: ViewFrames = {}

    def start(self, frames: ViewFrames) -> Moment:
        """The first time step: the scene's initial poses."""
        self._frames = frames
        zero = np.zeros_like(self._bodies)
        return Moment(self._follower.states, zero, self._share(self._bodies, frames), 0)

    def follow(self, action: int, frames: ViewFrames) -> Moment:
        """The next time step, reached by an action."""
        predicted = self._follower.predict(POINTS[action])
        discs = self._fitter.discs
        predicted[discs, 2] = self._bodies[discs, 2]
        if all(np.array_equal(frames[view], self._frames[view]) for view in View):
            fit, unseen = Fit(self._bodies, np.zeros_like(self._bodies)), 0
        else:
            fit = self._fit(predicted, frames)
            unseen = self._keep(fit)
        self._follower.correct(fit.bodies)
        self._frames, self._bodies = frames, fit.bodies
        share = self._share(fit.bodies, frames)
        return Moment(self._follower.states, fit.deviations, share, unseen)

    def _fit(self, predicted: Bodies, frames: ViewFrames) -> Fit:
        """The best fit from several initial guesses, the simulated one first."""
        labels = self._fitter.label(frames)
        guess = np.concatenate([predicted[:FIRST_BLOCK], self._bodies[FIRST_BLOCK:]])
        moved = list(self._blocks_near(self._wrong(View.ALLO, guess, frames)))
        guess[moved] = predicted[moved]
        best = self._fitter.fit(guess, labels, [*range(FIRST_BLOCK), *moved])
        share = self._share(best.bodies, frames)
        for other in (guess, self._bodies):
            if share > RETRY:
                fit = self._fitter.fit(other, labels, range(len(guess)), FAR_STAGES)
                new = self._share(fit.bodies, frames)
                best, share = (fit, new) if new < share else (best, share)
        return best

    def _keep(self, fit: Fit) -> int:
        """Keep the last poses of unseen bodies and of blocks at rest; returns the number unseen."""
        before, bodies, deviations = self._bodies, fit.bodies, fit.deviations
        bodies[:] = np.where(deviations > 0.0, np.round(bodies / GRID) * GRID, bodies)
        unseen = (deviations > UNSEEN).any(axis=1)
        moved = np.abs(bodies - before) > SIGNIFICANT * deviations
        still = ~moved.any(axis=1) & (np.arange(len(bodies)) >= FIRST_BLOCK)
        bodies[unseen | still] = before[unseen | still]
        deviations[unseen | still] = 0.0
        bodies[EYES, :2] = bodies[ROBOT, :2]
        return int(unseen.sum())

    def _blocks_near(self, wrong: Mask) -> Iterator[int]:
        """The rows of the blocks near any wrong pixel of the allocentric view."""
        rows, columns = np.nonzero(wrong)
        x = (columns + 0.5) * VIEW_WIDTH / RAW_FRAME_SIZE - VIEW_WIDTH / 2
        y = VIEW_WIDTH / 2 - (rows + 0.5) * VIEW_WIDTH / RAW_FRAME_SIZE
        for row in range(FIRST_BLOCK, len(self._bodies)):
            block_x, block_y, _ = self._bodies[row]
            if (np.hypot(x - block_x, y - block_y) < _REACH).any():
                yield row

    def _share(self, bodies: Bodies, frames: ViewFrames) -> float:
        return float(np.mean([self._wrong(view, bodies, frames).mean() for view in View]))

    def _wrong(self, view: View, bodies: Bodies, frames: ViewFrames) -> Mask:
        rendered, recorded = self._rendered, frames[view]
        self._renderers[view].render(bodies, rendered)
        wrong = np.maximum(rendered, recorded) - np.minimum(rendered, recorded) > TOLERANCE
        return wrong[..., 0] | wrong[..., 1] | wrong[..., 2]  # `any` is ten times slower


if __name__ == "__main__":
    main()
