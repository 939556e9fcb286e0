"""The observations of a stored trajectory, bit for bit as the environment returned them."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from magical.demos.trajectory import Trajectory
from magical.errors import TrajectoryError
from magical.observe import Observation, make_spec
from magical.observe.pixels import copy_pixels
from magical.scene import Scene, View
from magical.scene.constants import FRAME_SIZE, RAW_FRAME_SIZE

Pixels = NDArray[np.uint8]


class Frames:
    """Single frames of one trajectory and view, rendered from poses or copied from the recording.

    Raises `TrajectoryError` if only frames were recorded, and not with this view, size and samples.
    """

    def __init__(
        self,
        trajectory: Trajectory,
        view: View | str,
        size: int = FRAME_SIZE,
        samples: int | None = None,
    ) -> None:
        self.size = size
        self._rows: NDArray[Any]  # poses or recorded frames, one for each time step
        self._write: Callable[[NDArray[Any], Pixels], None]  # writes the frame of a row
        if trajectory.poses is not None:
            from magical import render  # imports numba: only when something is rendered

            renderer = render.Renderer(trajectory.scene, view, size, samples)
            self._rows, self._write = trajectory.poses, renderer.render
        else:
            recorded = trajectory.frames or {}
            averaged = RAW_FRAME_SIZE // FRAME_SIZE
            if view not in recorded or size != FRAME_SIZE or samples not in (None, averaged):
                raise TrajectoryError(
                    f"{trajectory.env_id}: this recording has only frames of {FRAME_SIZE} x "
                    f"{FRAME_SIZE} pixels of the views {', '.join(recorded)}, not {view} frames "
                    f"of {size} x {size} with {samples or 'any'} samples; use a preset of that size"
                )
            self._rows, self._write = recorded[view], copy_pixels

    def render(self, time: int, out: Pixels) -> None:
        """Write the frame at time step `time`, 0 to T, into `out` (size, size, 3)."""
        self._write(self._rows[time], out)

    def take(self, times: ArrayLike) -> Pixels:
        """The frames at several time steps: (len(times), size, size, 3) uint8."""
        times = np.asarray(times, np.intp)
        frames = np.empty((len(times), self.size, self.size, 3), np.uint8)
        for time, frame in zip(times.tolist(), frames, strict=True):
            self.render(time, frame)
        return frames


class TrajectorySource:
    """A trajectory as an `EpisodeSource`; its renderers are cached."""

    def __init__(self, trajectory: Trajectory) -> None:
        self.trajectory = trajectory
        self._frames: dict[tuple[View, int, int | None], Frames] = {}

    @property
    def scene(self) -> Scene:
        """The initial scene."""
        return self.trajectory.scene

    def __len__(self) -> int:
        """The number of actions, T."""
        return len(self.trajectory)

    def frames(self, view: View, size: int, samples: int | None) -> Frames:
        """The frames in one view at one resolution; raises `TrajectoryError` as `Frames` does."""
        key = view, size, samples
        if key not in self._frames:
            self._frames[key] = Frames(self.trajectory, *key)
        return self._frames[key]

    def body_states(self) -> NDArray[np.float64]:
        """Poses and velocities, (T + 1, 5 + blocks, 6); raises `TrajectoryError` if unknown."""
        bodies = self.trajectory.bodies
        if bodies is None or np.isnan(bodies).any():
            raise TrajectoryError(
                f"{self.trajectory.env_id}: expected poses and velocities, found a recording of "
                f"{'frames' if bodies is None else 'poses'}; use an observation of pixels"
            )
        return bodies


def observations(
    trajectory: Trajectory, observation: Observation = "LoRes4E", times: ArrayLike | None = None
) -> Any:
    """The observations that the environment returned: an array (T + 1, *shape), or a dict of them.

    Observation 0 is what `reset` returned, observation t what the t-th `step` returned. `times` are
    time steps from 0 to T (default: all). Raises `TrajectoryError` if a recording of frames lacks
    the observation, or velocities, which state vectors need, are unknown.
    """
    steps = np.arange(len(trajectory) + 1) if times is None else np.asarray(times, np.intp)
    if len(steps) and not 0 <= steps.min() <= steps.max() <= len(trajectory):
        found = f"{steps.min()} to {steps.max()}"
        raise TrajectoryError(f"time steps: expected 0 to {len(trajectory)}, found {found}")
    return make_spec(observation, trajectory.task).read(TrajectorySource(trajectory), steps)
