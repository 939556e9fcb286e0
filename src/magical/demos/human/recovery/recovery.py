"""The poses of one published recording, and how well they are known."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from magical.demos.human.published import PublishedDemonstration
from magical.demos.human.recovery.track import TOLERANCE, Tracker
from magical.demos.store.trajectory import RECOVERY, Trajectory
from magical.scene.poses import EYES, FINGERS, FIRST_BLOCK, ROBOT

LIMIT = 0.005  # share of wrong pixels in one frame, above which poses are not accepted
_GROUPS = {
    "robot": slice(ROBOT, ROBOT + 1),
    "fingers": FINGERS,
    "eyes": EYES,
    "blocks": slice(FIRST_BLOCK, None),
}


@dataclass(frozen=True, slots=True)
class Recovery:
    """What was recovered from the T + 1 frames of a recording, or from the first N of them."""

    poses: NDArray[np.float64]  # (N, 5 + blocks, 3)
    deviations: NDArray[np.float64]  # (N, 5 + blocks, 3): standard deviations; 0 where unchanged
    wrong: NDArray[np.float64]  # (N,): share of pixels that differ by more than `TOLERANCE`
    covered: int  # frames in which the robot and a block overlap in the allocentric view
    unseen: int  # poses that were kept because no pixel determined them, over all frames
    problem: str | None = None  # why the poses are not to be used

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
            "covered_frames": self.covered,
            "unseen_poses": self.unseen,
        }

    def _deviation(self, rows: slice) -> dict[str, float]:
        """The 95th percentile over what was fitted, in units and radians."""
        fitted = self.deviations[:, rows]
        parts = {"position": fitted[..., :2].max(axis=-1), "angle": fitted[..., 2]}
        return {
            name: round(float(np.percentile(part[part > 0], 95)), 7) if part.any() else 0.0
            for name, part in parts.items()
        }


def recover(demonstration: PublishedDemonstration) -> Recovery:
    """Recover the poses of all bodies at every time step; stops at a frame that fits nowhere."""
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
        sum(moment.covered for moment in moments),
        sum(moment.unseen for moment in moments),
        _problem(wrong),
    )


def recovered_trajectory(
    demonstration: PublishedDemonstration, keep_frames: bool = False
) -> Trajectory:
    """The trajectory of the recovered poses, or of the averaged frames if that was not possible.

    The metadata says how well the poses are known, or why they are missing.

    Args:
        demonstration: the published file.
        keep_frames: keep the frames beside the poses.
    """
    recovery = recover(demonstration)
    metadata: Mapping[str, Any] = {RECOVERY: recovery.metadata()}
    if recovery.problem:
        return demonstration.trajectory(**metadata)
    return Trajectory.from_poses(
        str(demonstration.env_id),
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
