"""An episode as the page shows it: what happened in each step, and the frames."""

import struct
from functools import cached_property
from typing import Any

from numpy.typing import NDArray

from magical.demos.trajectory import Trajectory
from magical.errors import NotFoundError, TrajectoryError
from magical.scene import Poses
from magical.web.frames import encode_webp, render_webp
from magical.web.messages import PAGE_VIEWS

MAX_STEPS = 5000  # length of the longest episode that can be viewed: ten minutes


class ViewedEpisode:
    """One episode, opened for viewing.

    Raises:
        TrajectoryError: the episode is too long to be shown.
    """

    def __init__(self, trajectory: Trajectory) -> None:
        if len(trajectory) > MAX_STEPS:
            raise TrajectoryError(
                f"expected an episode of at most {MAX_STEPS} steps, found {len(trajectory)}"
            )
        self.trajectory = trajectory

    @cached_property
    def details(self) -> dict[str, Any]:
        """Everything except the frames, as plain JSON data.

        `scores` has the score of each of the T + 1 states; `None` if poses are not known.
        """
        episode = self.trajectory
        return {
            "env_id": episode.env_id,
            "task": episode.env_id.task,
            "seed": episode.seed,
            "demonstrator": episode.demonstrator,
            "steps": len(episode),
            "views": self.views,
            "has_poses": episode.poses is not None,
            "is_recovered": "recovery" in episode.metadata,
            "score": episode.score,
            "published_code_score": episode.published_code_score,
            "scores": self._scores(),
            "actions": episode.actions.tolist(),
            "expert_actions": _plain(episode.expert_actions),
            "policy_actions": _plain(episode.policy_actions),
            "actors": _plain(episode.actors),
            "policy": str(episode.metadata.get("policy", "")),
        }

    @property
    def views(self) -> list[str]:
        """The names in `PAGE_VIEWS` for which frames are available."""
        stored = self.trajectory.frames
        if self.trajectory.poses is not None or stored is None:
            return list(PAGE_VIEWS)
        return [name for name, views in PAGE_VIEWS.items() if set(views) <= set(stored)]

    def frames(self, view: str, first: int, count: int) -> bytes:
        """Frames of the states from `first` on, as WebP files.

        Each file is preceded by its size in bytes, as a big-endian 32-bit integer.

        Args:
            view: one of `PAGE_VIEWS`.
            first: the first state, 0 to T.
            count: the maximum number of frames; there are fewer at the end of the episode.

        Raises:
            NotFoundError: there is no such state, or the episode was not recorded in this view.
        """
        if first > len(self.trajectory) or view not in self.views:
            raise NotFoundError(
                f"frames: expected states 0 to {len(self.trajectory)} in one of the views "
                f"{', '.join(self.views)}, found {first} and {view}"
            )
        last = min(first + count, len(self.trajectory) + 1)
        files = [self._frame(view, time) for time in range(first, last)]
        return b"".join(struct.pack(">I", len(file)) + file for file in files)

    def _frame(self, view: str, time: int) -> bytes:
        episode, views = self.trajectory, PAGE_VIEWS[view]
        if episode.poses is not None:
            return render_webp(episode.scene, Poses(episode.poses[time]), views)
        assert episode.frames is not None
        return encode_webp([episode.frames[name][time] for name in views])

    def _scores(self) -> list[float] | None:
        episode = self.trajectory
        if episode.poses is None:
            return None
        return [
            round(float(episode.task.score(episode.scene, Poses(bodies))), 4)
            for bodies in episode.poses
        ]


def _plain(array: NDArray[Any] | None) -> list[Any] | None:
    return None if array is None else array.tolist()
