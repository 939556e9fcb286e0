"""What the environment showed, drawn again from a stored trajectory, bit for bit."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from magical.demos.trajectory import FRAME_SIZE, Trajectory
from magical.errors import TrajectoryError
from magical.observe import Observation, PixelSpec, StateLayout, StateObserver, parse_observation
from magical.observe.spec import RAW_RESOLUTION
from magical.physics import World
from magical.scene import View

if TYPE_CHECKING:
    from magical.demos.dataset import Dataset
    from magical.render import Renderer

Pixels = NDArray[np.uint8]
Arrays = NDArray[Any] | dict[str, NDArray[Any]]


class Frames:
    """Single frames of one trajectory and view, drawn from poses or taken from the recording.

    Raises `TrajectoryError` where only pictures were recorded, and others are asked for.
    """

    def __init__(
        self,
        trajectory: Trajectory,
        view: View | str,
        size: int = FRAME_SIZE,
        samples: int | None = None,
    ) -> None:
        self.size = size
        self._poses = trajectory.poses
        self._recorded: Pixels | None = None
        self._renderer: Renderer | None = None
        if trajectory.poses is not None:
            from magical import render  # drawing brings in numba: only when needed

            self._renderer = render.Renderer(trajectory.scene, View(view), size, samples)
        else:
            self._recorded = _recorded(trajectory, str(view), size, samples)

    def draw(self, time: int, out: Pixels) -> None:
        """Write the frame of one moment, 0 to T, into `out` (size, size, 3), of any layout."""
        if self._renderer is None:
            assert self._recorded is not None
            copy_pixels(self._recorded[time], out)
        else:
            assert self._poses is not None
            self._renderer.draw(self._poses[time], out)

    def take(self, times: ArrayLike) -> Pixels:
        """The frames of several moments: (len(times), size, size, 3) uint8."""
        moments = np.asarray(times, np.intp)
        frames = np.empty((len(moments), self.size, self.size, 3), np.uint8)
        for time, frame in zip(moments.tolist(), frames, strict=True):
            self.draw(time, frame)
        return frames


class ObservationReader:
    """Random access to the observations of one trajectory, for training.

    Frames that several of the asked-for observations share are drawn once.
    """

    def __init__(self, trajectory: Trajectory, observation: Observation = "LoRes4E") -> None:
        form = parse_observation(observation)
        if not isinstance(form, PixelSpec):
            raise TrajectoryError(f"expected a pixel observation, found {observation!r}")
        self.spec = form
        self.moments = len(trajectory) + 1
        self._frames = {
            view: Frames(trajectory, view, form.size, form.samples) for view, _ in form.parts
        }

    def read(self, times: ArrayLike, out: Arrays | None = None) -> Arrays:
        """The observations at moments `times` (B,), each 0 to T: (B, *shape), or a dict of such.

        Moment 0 is what `reset` showed, moment t what step t showed. Raises `TrajectoryError` for
        moments that are not in the trajectory.
        """
        moments = np.atleast_1d(np.asarray(times, np.intp))
        if len(moments) and (moments.min() < 0 or moments.max() >= self.moments):
            raise TrajectoryError(
                f"moments: expected 0 to {self.moments - 1}, "
                f"found {moments.min()} to {moments.max()}"
            )
        out = empty(self.spec, len(moments)) if out is None else out
        first = 0
        for view, count in self.spec.parts:
            array = out[str(view)] if isinstance(out, dict) else out
            if self.spec.channels_first:
                array = array.transpose(0, 2, 3, 1)
            if not self.spec.separate:
                array = array[..., first : first + 3 * count]
            self._fill(array, view, count, moments)
            first += 3 * count
        return out

    def _fill(self, array: Pixels, view: View, count: int, moments: NDArray[np.intp]) -> None:
        """Draw each frame where it shows first, and copy it from there to wherever else it does."""
        frames = self._frames[view]
        shown = np.maximum(moments[:, None] + np.arange(1 - count, 1), 0)  # (B, count)
        drawn: dict[int, Pixels] = {}
        for stack, times in zip(array, shown.tolist(), strict=True):
            for k, time in enumerate(times):
                place = stack[..., 3 * k : 3 * k + 3]
                if time in drawn:
                    copy_pixels(drawn[time], place)
                else:
                    frames.draw(time, place)
                    drawn[time] = place


def copy_pixels(source: Pixels, out: Pixels) -> None:
    """Copy a picture channel by channel: pixel by pixel, NumPy takes three times as long."""
    for channel in range(3):
        out[..., channel] = source[..., channel]


def observations(
    trajectory: Trajectory,
    observation: Observation = "LoRes4E",
    times: ArrayLike | None = None,
) -> Arrays:
    """The observations that the environment showed: (T + 1, *shape), or a dict of such.

    Any preset, "raw" (384 x 384), a `PixelSpec` or its fields, at the moments `times` or at all.
    "state" is simulated again, since velocities are not stored.

    Raises:
        TrajectoryError: a recording that has only pictures has no others; or today's physics does
            not repeat the trajectory, which "state" needs.
        UnknownNameError: no such observation.
    """
    moments = np.arange(len(trajectory) + 1) if times is None else np.asarray(times, np.intp)
    if parse_observation(observation) == "state":
        return _states(trajectory)[moments]
    return ObservationReader(trajectory, observation).read(moments)


def observation_at(
    trajectory: Trajectory, time: int, observation: Observation = "LoRes4E"
) -> Arrays:
    """One observation; for many, an `ObservationReader` is faster."""
    batch = observations(trajectory, observation, [time])
    if isinstance(batch, dict):
        return {view: array[0] for view, array in batch.items()}
    single: NDArray[Any] = batch[0]
    return single


def dataset_arrays(dataset: "Dataset", observation: Observation = "LoRes4E") -> dict[str, Any]:
    """Every step of every trajectory, N in all, as plain arrays.

    Returns:
        `observations` (N, *shape), or a dict of such: what was seen before each action.
        `actions` (N,) int64.
        `episodes` (N,) int64: which trajectory, counted from 0 in the dataset's order.
        `steps` (N,) int64: which step of it.
        `env_ids`, `scores`, `published_code_scores`, `demonstrators`: one for each trajectory.

    Raises what `observations` raises.
    """
    lengths = [entry.length for entry in dataset.entries]
    total, form = sum(lengths), parse_observation(observation)
    shown: Any = None
    actions = np.empty(total, np.int64)
    start = 0
    for trajectory in dataset:
        rows = slice(start, start + len(trajectory))
        actions[rows] = trajectory.actions
        if isinstance(form, PixelSpec):
            shown = empty(form, total) if shown is None else shown
            part = (
                {view: array[rows] for view, array in shown.items()}
                if isinstance(shown, dict)
                else shown[rows]
            )
            ObservationReader(trajectory, form).read(np.arange(len(trajectory)), part)
        else:
            states = _states(trajectory)[:-1]
            shown = np.empty((total, states.shape[1]), states.dtype) if shown is None else shown
            shown[rows] = states
        start = rows.stop
    return {
        "observations": shown,
        "actions": actions,
        "episodes": np.repeat(np.arange(len(lengths)), lengths),
        "steps": _counted(lengths),
        "env_ids": np.array([entry.env_id for entry in dataset.entries]),
        "scores": np.array([np.nan if e.score is None else e.score for e in dataset.entries]),
        "published_code_scores": np.array([e.published_code_score for e in dataset.entries]),
        "demonstrators": np.array([entry.demonstrator for entry in dataset.entries]),
    }


def empty(spec: PixelSpec, count: int) -> Arrays:
    """Arrays for `count` observations, not yet drawn."""
    if spec.separate:
        return {str(v): np.empty((count, *spec.shape(n)), np.uint8) for v, n in spec.parts}
    return np.empty((count, *spec.shape(sum(n for _, n in spec.parts))), np.uint8)


def _counted(lengths: Sequence[int]) -> NDArray[np.int64]:
    return np.concatenate(
        [np.arange(n, dtype=np.int64) for n in lengths] or [np.empty(0, np.int64)]
    )


def _recorded(trajectory: Trajectory, view: str, size: int, samples: int | None) -> Pixels:
    averaged = RAW_RESOLUTION // FRAME_SIZE
    frames = (trajectory.frames or {}).get(view)
    if frames is None or size != FRAME_SIZE or samples not in (None, averaged):
        raise TrajectoryError(
            f"{trajectory.env_id}: this recording has only pictures of {FRAME_SIZE} x {FRAME_SIZE} "
            f"pixels of the views {', '.join(trajectory.frames or {})}, not {view} frames of "
            f"{size} x {size} with {samples or 'any'} samples; use a preset of that size"
        )
    return frames


def _states(trajectory: Trajectory) -> NDArray[np.float32]:
    """The state vectors (T + 1, size), from simulating the trajectory again."""
    if trajectory.poses is None:
        raise TrajectoryError(f"{trajectory.env_id}: a recording of pictures has no states")
    task = trajectory.task
    observer = StateObserver(StateLayout(task.max_blocks, task.max_regions))
    world = World(trajectory.scene, trajectory.dynamics)
    observer.start(trajectory.scene, world.read())
    states = [observer.copy()]
    for time, action in enumerate(trajectory.actions.tolist(), 1):
        world.step(action)
        table = world.read()
        if not np.array_equal(table[:, :3], trajectory.poses[time]):
            raise TrajectoryError(
                f"{trajectory.env_id}: today's physics departs from the recorded poses at step "
                f"{time}, so its velocities are unknown; record it again with this version"
            )
        observer.update(table)
        states.append(observer.copy())
    return np.stack(states)
