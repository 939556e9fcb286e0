"""The observations of a stored trajectory, bit for bit as the environment returned them."""

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from magical.demos.motion import PoseFollower
from magical.demos.store.trajectory import Trajectory
from magical.envs.action_spec import CONTINUOUS, Actions
from magical.errors import ObservationError, TrajectoryError
from magical.observe import Observation, make_spec
from magical.observe.arrays import SINGLE, empty, select
from magical.observe.pixels import copy_pixels
from magical.physics import Simulation
from magical.scene import Scene, View
from magical.scene.constants import FRAME_SIZE, RAW_FRAME_SIZE

Pixels = NDArray[np.uint8]


class Frames:
    """Single frames of one trajectory and view, rendered from poses or copied from the recording.

    Raises:
        UnknownNameError: there is no such view.
        TrajectoryError: only frames were recorded, and not with this view, size and samples.
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
        """Poses and velocities, (T + 1, 5 + blocks, 6) float64.

        If velocities were not recorded, the actions are simulated again; if the poses were
        recovered from frames, the simulation follows them (see `estimated_states`).

        Raises:
            TrajectoryError: poses are unknown; or velocities are, and the simulation does not
                reproduce the poses.
        """
        trajectory = self.trajectory
        if trajectory.poses is None:
            raise TrajectoryError(
                f"{trajectory.env_id}: a recording of frames has no states; those of human "
                "demonstrations are recovered by an import without --frames-only"
            )
        if trajectory.velocities is not None:
            return np.concatenate([trajectory.poses, trajectory.velocities], axis=2)
        if trajectory.is_recovered:
            return estimated_states(trajectory)
        simulation = Simulation(trajectory.scene, trajectory.dynamics)
        states = [simulation.read()]
        for time, point in enumerate(CONTINUOUS.convert(trajectory.actions), 1):
            states.append(simulation.step(point))
            if not np.array_equal(states[-1][:, :3], trajectory.poses[time]):
                raise TrajectoryError(
                    f"{trajectory.env_id}: the simulation departs from the recorded poses at step "
                    f"{time}, so velocities are unknown; record the trajectory with this version"
                )
        return np.stack(states)


class ObservationReader:
    """Random access to the observations of one trajectory, for training.

    Args:
        trajectory: the stored episode.
        observation: see `magical.observe.make_spec`.
    """

    def __init__(self, trajectory: Trajectory, observation: Observation = "LoRes4E") -> None:
        self.spec = make_spec(observation, trajectory.task)
        self._source = TrajectorySource(trajectory)

    def read(self, times: ArrayLike, out: Any = None) -> Any:
        """Observations at time steps `times` (B,), each 0 to T.

        Observation 0 is what `reset` returned, observation t what the t-th `step` returned.

        Args:
            times: time steps.
            out: where to write the observations (default: new arrays).

        Returns:
            An array (B, *shape), or a dict of such arrays.

        Raises:
            TrajectoryError: a time step is outside the trajectory, or the trajectory lacks what
                the observation needs.
        """
        steps = np.atleast_1d(np.asarray(times, np.intp))
        last = len(self._source)
        if len(steps) and (steps.min() < 0 or steps.max() > last):
            raise TrajectoryError(
                f"time steps: expected 0 to {last}, found {steps.min()} to {steps.max()}"
            )
        return self.spec.read(self._source, steps, out)


def observations(
    trajectory: Trajectory, observation: Observation = "LoRes4E", times: ArrayLike | None = None
) -> Any:
    """The observations that the environment returned: an array (T + 1, *shape), or a dict of them.

    Args:
        trajectory: the stored episode.
        observation: see `magical.observe.make_spec`.
        times: time steps from 0 to T (default: all).

    Raises:
        TrajectoryError: a recording of frames lacks the observation; or velocities, which state
            vectors need, were not recorded and the simulation does not reproduce the trajectory.
        UnknownNameError: there is no such observation.
    """
    steps = np.arange(len(trajectory) + 1) if times is None else times
    return ObservationReader(trajectory, observation).read(steps)


def read_all(
    trajectories: Iterable[Trajectory], total: int, observation: Observation
) -> dict[str, Any]:
    """All `total` steps of the trajectories as plain arrays; see `Dataset.arrays`."""
    batch: Any = None
    actions: list[Actions] = []
    labels: list[Actions] = []
    demonstrated = np.empty(total, np.bool_)
    start = 0
    for trajectory in trajectories:
        rows = slice(start, start + len(trajectory))
        actions.append(trajectory.actions)
        labels.append(trajectory.labels)
        demonstrated[rows] = trajectory.is_demonstrated
        reader = ObservationReader(trajectory, observation)
        fields = reader.spec.fields
        batch = empty(fields, (total,)) if batch is None else batch
        if SINGLE in fields and batch.shape[1:] != fields[SINGLE][0]:
            raise ObservationError(
                f"expected observations of one shape {batch.shape[1:]}, found {fields[SINGLE][0]}; "
                "filter the dataset by task, or use a pixel observation"
            )
        reader.read(np.arange(len(trajectory)), select(batch, rows))
        start = rows.stop
    return {
        "observations": batch,
        "actions": _concatenated(actions),
        "labels": _concatenated(labels),
        "is_demonstrated": demonstrated,
    }


def _concatenated(columns: Sequence[Actions]) -> Actions:
    """Actions of several trajectories, all continuous if any are."""
    if len({column.ndim for column in columns}) > 1:
        columns = [CONTINUOUS.convert(column) for column in columns]
    return np.concatenate(columns) if columns else np.empty(0, np.int64)


def estimated_states(trajectory: Trajectory) -> NDArray[np.float64]:
    """Recorded poses with estimated velocities, (T + 1, 5 + blocks, 6); see `PoseFollower`."""
    assert trajectory.poses is not None
    follower = PoseFollower(trajectory.scene, trajectory.dynamics)
    states = [follower.states]
    points = CONTINUOUS.convert(trajectory.actions)
    for point, bodies in zip(points, trajectory.poses[1:], strict=True):
        follower.predict(point)
        follower.correct(bodies)
        states.append(follower.states)
    return np.stack(states)
