"""Recovering the poses of a published recording, frame by frame, with their uncertainty."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from magical.demos.human.published import PublishedDemonstration
from magical.demos.human.recovery.fit import FAR_STAGES, Bodies, Fit, PoseFitter
from magical.demos.motion import PoseFollower
from magical.demos.store.trajectory import RECOVERY, Trajectory
from magical.render import Renderer
from magical.render.kernel import VIEW_WIDTH
from magical.scene import Poses, Scene, View
from magical.scene.constants import BLOCK_SIZE, RAW_FRAME_SIZE, STAR_OUTER_RADIUS
from magical.scene.poses import EYES, FINGERS, FIRST_BLOCK, ROBOT

LIMIT = 0.005  # share of wrong pixels in one frame, above which poses are not accepted
TOLERANCE = 8  # grey levels: pixels that differ by more in any channel are wrong
RETRY = 1e-3  # share of wrong pixels above which other initial guesses are tried
NEARBY = 0.03  # units around a block within which wrong pixels may be due to it
SIGNIFICANT = 3.0  # standard deviations: a block that seems to have moved less counts as at rest
UNSEEN = 0.1  # units or radians: standard deviation of a pose that the pixels do not determine
GRID = 2.0**-17  # units or radians: rounding of the poses, far below their uncertainty
_GROUPS = {
    "robot": slice(ROBOT, ROBOT + 1),
    "fingers": FINGERS,
    "eyes": EYES,
    "blocks": slice(FIRST_BLOCK, None),
}
_SHAPE = (RAW_FRAME_SIZE, RAW_FRAME_SIZE, 3)
_REACH = max(BLOCK_SIZE, STAR_OUTER_RADIUS) + NEARBY  # units

ViewFrames = Mapping[View, NDArray[np.uint8]]  # (384, 384, 3) in both views
Mask = NDArray[np.bool_]  # (384, 384)


@dataclass(frozen=True, slots=True)
class Recovery:
    """The poses recovered from the T + 1 frames of a recording, or from the first N of them."""

    poses: NDArray[np.float64]  # (N, 5 + blocks, 3)
    deviations: NDArray[np.float64]  # (N, 5 + blocks, 3): standard deviations; 0 if unchanged
    wrong: NDArray[np.float64]  # (N,): share of pixels that differ by more than `TOLERANCE`
    unseen: int  # number of poses kept because no pixel determined them, over all frames
    problem: str | None = None  # why the poses must not be used

    def metadata(self) -> dict[str, Any]:
        """Plain data for a trajectory's metadata."""
        if self.problem:
            return {"problem": self.problem}
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


def recover(demonstration: PublishedDemonstration) -> Recovery:
    """Recover the poses of all bodies at every time step, up to a frame that no poses explain."""
    tracker = Tracker(demonstration.env_id.task_spec.demo)
    moments = [tracker.start(demonstration.frames(0))]
    for time, action in enumerate(demonstration.actions.tolist(), 1):
        if moments[-1].wrong > LIMIT:
            break
        moments.append(tracker.follow(action, demonstration.frames(time)))
    wrong = np.array([moment.wrong for moment in moments])
    return Recovery(
        np.stack([moment.bodies for moment in moments]),
        np.stack([moment.deviations for moment in moments]),
        wrong,
        sum(moment.unseen for moment in moments),
        _problem(wrong),
    )


def recovered_trajectory(
    demonstration: PublishedDemonstration, keep_frames: bool = False
) -> Trajectory:
    """The trajectory of the recovered poses, or of the averaged frames if that was not possible.

    The metadata says how well the poses are known, or why they are missing. With `keep_frames` the
    averaged frames are kept along with the poses.
    """
    recovery = recover(demonstration)
    metadata: Mapping[str, Any] = {RECOVERY: recovery.metadata()}
    if recovery.problem:
        return demonstration.trajectory(**metadata)
    return Trajectory.from_poses(
        demonstration.env_id,
        demonstration.env_id.task_spec.demo,
        demonstration.actions,
        recovery.poses,
        frames=demonstration.averaged() if keep_frames else None,
        demonstrator="human",
        metadata={**demonstration.source, "recorded_score": demonstration.score, **metadata},
    )


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

    bodies: Bodies  # poses, in the rows of `Poses`
    deviations: Bodies  # standard deviations; 0 for poses that were kept
    wrong: float  # share of pixels in both views that differ by more than `TOLERANCE`
    unseen: int  # bodies that kept their poses because the pixels do not determine them


class Tracker:
    """Recovers the poses of one episode, which starts at rest in `scene`.

    The initial guess for each time step is simulated from the previous one; the recovered poses
    depend only on the frames, to the precision that these allow. A body about which the pixels
    say nothing new keeps its pose.
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
        bodies = self._bodies
        return Moment(bodies, np.zeros_like(bodies), self._share(bodies, frames), 0)

    def follow(self, action: int, frames: ViewFrames) -> Moment:
        """The next time step, reached by an action."""
        predicted = self._follower.predict(action)
        discs = self._fitter.discs
        predicted[discs, 2] = self._bodies[discs, 2]
        if all(np.array_equal(frames[view], self._frames[view]) for view in View):
            fit, unseen = Fit(self._bodies, np.zeros_like(self._bodies)), 0
        else:
            fit = self._fit(predicted, frames)
            unseen = self._keep(fit)
        self._follower.correct(fit.bodies)
        self._frames, self._bodies = frames, fit.bodies
        return Moment(fit.bodies, fit.deviations, self._share(fit.bodies, frames), unseen)

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
