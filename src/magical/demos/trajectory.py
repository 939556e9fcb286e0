"""The trajectory of one episode, its observations, and its replay."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from enum import IntEnum
from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from magical.envs.action_spec import (
    CONTINUOUS,
    DISCRETE,
    Actions,
    ActionSpaceName,
    action_spec,
    spec_of,
)
from magical.envs.ids import EnvId, parse_env_id
from magical.errors import InvalidActionError, TrajectoryError
from magical.observe import Observation, copy_pixels, make_spec
from magical.physics import Simulation
from magical.scene import FIRST_BLOCK, Dynamics, Poses, Scene, View
from magical.scene.constants import FRAME_SIZE, RAW_FRAME_SIZE
from magical.tasks import Task

VIEWS = tuple(str(view) for view in View)
MAX_POSE = (10.0, 10.0, 1e6)  # units, units and radians: the workspace is [-1, 1] x [-1, 1]
MAX_VELOCITY = 1e6  # units and radians per second
TOLERANCE = 1e-6  # on scores, which other programs may have rounded to single precision
ACTION_COLUMNS = "actions", "expert_actions", "policy_actions"  # all of the same kind

Pixels = NDArray[np.uint8]


class Actor(IntEnum):
    """Who chose an executed action, in an episode with several actors."""

    POLICY = 0
    EXPERT = 1
    HUMAN = 2


@dataclass(frozen=True, slots=True, eq=False, repr=False, kw_only=True)
class Trajectory:
    """A recorded episode of T control steps, with T + 1 time steps from `reset` to its end.

    It has `bodies`, from which any view can be rendered exactly at any resolution, or `frames`, or
    both. Velocities that were not recorded are NaN. Arrays are made read-only.

    If actions other than the expert's were executed, as in perturbed demonstrations and in
    DAgger's episodes, `expert_actions` has the expert's choice in each state. Imitation learners
    learn `labels`. In an episode in which a person watched a policy and took over, `actors` says
    who acted, and `policy_actions` what the policy chose in each state. Learners leave out the
    steps that are not `is_demonstrated` (Kelly et al., "HG-DAgger", ICRA 2019).

    Raises:
        TrajectoryError: the parts do not match; the message names the one at fault.
        InvalidSceneError: no episode of the task can start from the scene.
        UnknownNameError: there is no such environment.
    """

    env_id: EnvId  # without a preset, such as magical/FindDupe-TestAll-v0; a string is parsed
    scene: Scene  # the initial scene
    actions: Actions  # (T,), or (T, 3) if continuous; executed
    published_code_score: float  # of the final state (docs/specification.md, section 9)
    score: float | None = None  # of the final state by the appendix's rule; None: poses unknown
    dynamics: Dynamics = field(default_factory=Dynamics)
    seed: int | None = None  # passed to `reset`, if known
    bodies: NDArray[np.float64] | None = None  # (T + 1, 5 + blocks, 6): poses and velocities
    frames: Mapping[str, Pixels] | None = None  # view: (T + 1, 96, 96, 3)
    expert_actions: Actions | None = None  # as `actions`; None: the executed ones
    actors: NDArray[np.uint8] | None = None  # (T,), of `Actor`; None: always the demonstrator
    policy_actions: Actions | None = None  # as `actions`, of the watched policy
    demonstrator: str = "unknown"  # the person or policy that chose the actions
    metadata: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        put = partial(object.__setattr__, self)
        put("env_id", parse_env_id(self.env_id).without_preset)
        self.task.validate(self.scene)
        steps, bodies = len(np.atleast_1d(self.actions)), FIRST_BLOCK + len(self.scene.blocks)
        spec = CONTINUOUS if np.ndim(self.actions) == 2 else DISCRETE
        if not steps:
            raise TrajectoryError("actions: expected at least one, found none")
        try:
            for name in ACTION_COLUMNS:
                if (column := getattr(self, name)) is not None:
                    put(name, _frozen(spec.checked_batch(column, steps, name)))
        except InvalidActionError as error:
            raise TrajectoryError(str(error)) from error
        if self.actors is not None:
            put("actors", _checked("actors", np.asarray(self.actors, np.uint8), "uint8", (steps,)))
            if self.actors.max() > max(Actor):
                raise TrajectoryError(f"actors: expected at most {max(Actor)}, found more")
        if self.bodies is not None:
            put("bodies", _checked("bodies", self.bodies, "float64", (steps + 1, bodies, 6)))
            size = np.abs(self.bodies)
            if not (size[..., :3] <= MAX_POSE).all() or (size[..., 3:] > MAX_VELOCITY).any():
                raise TrajectoryError(
                    f"bodies: expected finite x, y and angles of at most {MAX_POSE}, and "
                    f"velocities of at most {MAX_VELOCITY:g} or NaN, found {size.max(axis=(0, 1))}"
                )
        if self.frames is not None:
            shape = (steps + 1, FRAME_SIZE, FRAME_SIZE, 3)
            views = {str(view): frames for view, frames in self.frames.items()}
            if not set(views) <= set(VIEWS):
                raise TrajectoryError(f"frames: expected views of {VIEWS}, found {sorted(views)}")
            put("frames", {v: _checked(f"{v} frames", views[v], "uint8", shape) for v in views})
        if self.bodies is None and not self.frames:
            raise TrajectoryError("expected bodies or frames, found none")

    def __repr__(self) -> str:
        by = f"score {self.score}, by {self.demonstrator!r}"
        return f"Trajectory({str(self.env_id)!r}, {len(self)} steps, {by})"

    @staticmethod
    def from_bodies(
        env_id: str, scene: Scene, actions: ArrayLike, bodies: ArrayLike, **more: Any
    ) -> "Trajectory":
        """A trajectory whose two scores are computed from its final poses.

        `bodies` are (T + 1, 5 + blocks, 6), or (T + 1, 5 + blocks, 3) without velocities.
        """
        table, rows = np.asarray(bodies, np.float64), FIRST_BLOCK + len(scene.blocks)
        if table.shape[1:] not in ((rows, 3), (rows, 6)) or not len(table):
            raise TrajectoryError(f"bodies: expected (T + 1, {rows}, 6 or 3), found {table.shape}")
        parsed, last = parse_env_id(env_id), Poses(table[-1, :, :3])
        parsed.task_spec.validate(scene)
        more |= {"score": float(parsed.task_spec.score(scene, last))}
        more |= {"published_code_score": parsed.task_spec.published_code_score(scene, last)}
        table = table if table.shape[2] == 6 else without_velocities(table)
        return Trajectory(
            env_id=parsed, scene=scene, actions=np.asarray(actions), bodies=table, **more
        )

    def __len__(self) -> int:
        return len(self.actions)

    @property
    def poses(self) -> NDArray[np.float64] | None:
        """The poses of `bodies`, (T + 1, 5 + blocks, 3); rows as in `Poses`."""
        return None if self.bodies is None else np.ascontiguousarray(self.bodies[:, :, :3])

    @property
    def labels(self) -> Actions:
        """The actions to imitate: `expert_actions` if there are any, otherwise `actions`."""
        return self.actions if self.expert_actions is None else self.expert_actions

    @property
    def is_demonstrated(self) -> NDArray[np.bool_]:
        """Whether each label, (T,), is a demonstrator's, not a policy's own action."""
        if self.actors is None or self.expert_actions is not None:
            return np.ones(len(self), np.bool_)
        return np.asarray(self.actors != Actor.POLICY)

    @property
    def is_intended(self) -> NDArray[np.bool_]:
        """Whether each executed action, (T,), is one that a demonstrator chose."""
        same = (self.labels == self.actions).reshape(len(self), -1).all(axis=1)
        return np.asarray(self.is_demonstrated & same)

    @property
    def action_space(self) -> ActionSpaceName:
        """The kind of actions that it has."""
        return spec_of(self.actions).name

    def with_action_space(self, name: ActionSpaceName) -> "Trajectory":
        """The same episode with actions of another kind, which produce the same motions.

        Raises `TrajectoryError` if continuous actions are not among the 18 discrete ones.
        """
        if self.action_space == name:
            return self
        columns = {each: getattr(self, each) for each in ACTION_COLUMNS}
        convert = action_spec(name).convert
        try:
            found = {each: convert(c) for each, c in columns.items() if c is not None}
        except InvalidActionError as error:
            raise TrajectoryError(f"{self.env_id}: {error}") from error
        return replace(self, **found)  # type: ignore[arg-type]

    @property
    def task(self) -> Task:
        """The task that was demonstrated."""
        return self.env_id.task_spec


def without_velocities(poses: NDArray[np.float64]) -> NDArray[np.float64]:
    """Bodies (..., 6) with these poses (..., 3) and velocities that are not known."""
    return np.concatenate([poses, np.full_like(poses, np.nan)], axis=-1)


def _checked(name: str, values: ArrayLike, dtype: str, shape: tuple[int, ...]) -> NDArray[Any]:
    array = np.asarray(values)
    if array.shape != shape or array.dtype != dtype:
        raise TrajectoryError(
            f"{name}: expected {dtype} {shape} for {shape[0] - 1} actions and the scene, "
            f"found {array.dtype} {array.shape}"
        )
    return _frozen(array)


def _frozen(array: NDArray[Any]) -> NDArray[Any]:
    copied = array.copy() if array.flags.writeable or not array.flags.c_contiguous else array
    copied.flags.writeable = False
    return copied


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
                    f"of {size} x {size} with {samples or 'any'} samples"
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
        self.trajectory, self.scene = trajectory, trajectory.scene
        self.frames = cache(partial(Frames, trajectory))  # (view, size, samples) -> Frames

    def __len__(self) -> int:
        return len(self.trajectory)

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


@dataclass(frozen=True, slots=True)
class Replay:
    """The outcome of replaying one trajectory."""

    score: float  # of the final state, by the appendix's rule
    published_code_score: float
    agrees: bool  # with the recorded scores, by every rule with a recorded score
    departure: float | None  # largest deviation of a body's final x or y from the recorded one


def replay(trajectory: Trajectory) -> Replay:
    """Simulate a trajectory's actions from its initial scene, and score the final state."""
    simulation = Simulation(trajectory.scene, trajectory.dynamics)
    for point in action_spec("continuous").convert(trajectory.actions):
        simulation.step(point)
    poses, task, departure = simulation.poses(), trajectory.task, None
    if trajectory.bodies is not None:
        departure = float(np.abs(poses.bodies - trajectory.bodies[-1, :, :3])[:, :2].max())
    score = float(task.score(trajectory.scene, poses))
    published = float(task.published_code_score(trajectory.scene, poses))
    pairs = [(score, trajectory.score), (published, trajectory.published_code_score)]
    agrees = all(known is None or math.isclose(a, known, abs_tol=TOLERANCE) for a, known in pairs)
    return Replay(score, published, agrees, departure)
