"""The trajectory of one demonstration: initial scene, actions, and poses or recorded frames."""

import json
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from enum import IntEnum
from functools import partial
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
from magical.messages import quoted
from magical.scene import Dynamics, Poses, Scene, View
from magical.scene.constants import FRAME_SIZE
from magical.scene.poses import FIRST_BLOCK
from magical.tasks import Task
from magical.untrusted import MAX_BITS, check_plain

VIEWS = tuple(str(view) for view in View)
RECOVERY = "recovery"  # in the metadata: how poses were recovered from frames
MAX_NAME = 1000  # characters of an environment id or a demonstrator's name
MAX_POSE = (10.0, 10.0, 1e6)  # units, units and radians: the workspace is [-1, 1] x [-1, 1]
MAX_VELOCITY = (1e6, 1e6, 1e6)  # units and radians per second
_ACTIONS = "actions", "expert_actions", "policy_actions"  # all of the same kind
_ENV_ID = re.compile(r"[\w/-]{1,200}")


class Actor(IntEnum):
    """Who chose an executed action, in an episode with several actors."""

    POLICY = 0
    EXPERT = 1
    HUMAN = 2


@dataclass(frozen=True, slots=True, eq=False, repr=False, kw_only=True)
class Trajectory:
    """A recorded episode of T control steps, with T + 1 time steps from `reset` to its end.

    It has `poses`, from which any view can be rendered exactly at any resolution, or `frames`, or
    both. State vectors also need `velocities`; without them, the actions are simulated again.
    Arrays are made read-only; writeable ones are copied. Metadata must be plain JSON data.

    `actions` are the executed ones, which led from each pose to the next. They are discrete or
    continuous, as are all other actions of the episode. If actions other than the expert's were
    executed, as in perturbed demonstrations and in DAgger's episodes, `expert_actions` has the
    expert's choice in each state. Imitation learners learn `labels`.

    In an episode in which a person watched a policy and took over, `actors` says who acted in each
    step, and `policy_actions` what the policy chose in each state, executed or not. Learners leave
    out the steps that are not `is_demonstrated`, so that no policy learns its own mistakes (Kelly
    et al., "HG-DAgger: interactive imitation learning with human experts", ICRA 2019).

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
    poses: NDArray[np.float64] | None = None  # (T + 1, 5 + blocks, 3), rows as in `Poses`
    velocities: NDArray[np.float64] | None = None  # of the poses, per second; None: not recorded
    frames: Mapping[str, NDArray[np.uint8]] | None = None  # view: (T + 1, 96, 96, 3)
    expert_actions: Actions | None = None  # as `actions`; None: the executed ones
    actors: NDArray[np.uint8] | None = None  # (T,), of `Actor`; None: always the demonstrator
    policy_actions: Actions | None = None  # as `actions`, of the watched policy
    demonstrator: str = "unknown"  # the person or policy that chose the actions
    metadata: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        put = partial(object.__setattr__, self)
        put("env_id", parse_env_id(self.env_id).without_preset)
        self.task.validate(self.scene)
        put("actions", checked_actions("actions", self.actions, np.ndim(self.actions)))
        published = checked_score("published_code_score", self.published_code_score)
        put("published_code_score", published)
        count, ndim = len(self.actions), self.actions.ndim
        optional: dict[str, Callable[[Any], Any]] = {
            "expert_actions": partial(checked_actions, "expert_actions", ndim=ndim, count=count),
            "policy_actions": partial(checked_actions, "policy_actions", ndim=ndim, count=count),
            "actors": self._checked_actors,
            "poses": partial(self._checked_bodies, "poses", MAX_POSE),
            "velocities": partial(self._checked_bodies, "velocities", MAX_VELOCITY),
            "frames": self._checked_frames,
            "score": partial(checked_score, "score"),
            "seed": _checked_seed,
        }
        for name, checked in optional.items():
            if (value := getattr(self, name)) is not None:
                put(name, checked(value))
        if self.poses is None and self.frames is None:
            raise TrajectoryError("expected poses or frames, found none")
        if self.poses is None and self.velocities is not None:
            raise TrajectoryError("velocities: expected none without poses")
        if self.score is None and self.poses is not None:
            raise TrajectoryError("score: expected a number where poses are known; use from_poses")
        if not isinstance(self.demonstrator, str) or not 0 < len(self.demonstrator) <= MAX_NAME:
            raise TrajectoryError(
                f"demonstrator: expected a name of at most {MAX_NAME} characters, "
                f"found {quoted(self.demonstrator)}"
            )
        put("metadata", _checked_metadata(self.metadata))

    def __repr__(self) -> str:
        by = f"score {self.score}, by {self.demonstrator!r}"
        return f"Trajectory({str(self.env_id)!r}, {len(self)} steps, {by})"

    @staticmethod
    def from_poses(
        env_id: str, scene: Scene, actions: ArrayLike, poses: ArrayLike, **more: Any
    ) -> "Trajectory":
        """A trajectory whose two scores are computed from its final poses.

        `poses` are (T + 1, 5 + blocks, 3), or with velocities (T + 1, 5 + blocks, 6).
        """
        table, (rows, _) = np.asarray(poses, np.float64), Poses.at_rest(scene).bodies.shape
        if table.shape[1:] not in ((rows, 3), (rows, 6)) or not len(table):
            raise TrajectoryError(
                f"poses: expected shape (T + 1, {rows}, 3 or 6), found {table.shape}"
            )
        if table.shape[2] == 6:
            table, more["velocities"] = np.split(table, 2, axis=2)
        parsed, last = parse_env_id(env_id), Poses(table[-1])
        task = parsed.task_spec
        task.validate(scene)
        return Trajectory(
            env_id=parsed,
            scene=scene,
            actions=np.asarray(actions),
            poses=table,
            score=float(task.score(scene, last)),
            published_code_score=float(task.published_code_score(scene, last)),
            **more,
        )

    def __len__(self) -> int:
        """The number of actions, T."""
        return len(self.actions)

    @property
    def labels(self) -> Actions:
        """The actions to imitate: `expert_actions` if there are any, otherwise `actions`."""
        return self.actions if self.expert_actions is None else self.expert_actions

    @property
    def is_demonstrated(self) -> NDArray[np.bool_]:
        """Whether each label, (T,), is a demonstrator's, not a policy's own action."""
        if self.actors is None or self.expert_actions is not None:
            return np.ones(len(self), np.bool_)
        demonstrated: NDArray[np.bool_] = self.actors != Actor.POLICY
        return demonstrated

    @property
    def is_intended(self) -> NDArray[np.bool_]:
        """Whether each executed action, (T,), is one that a demonstrator chose."""
        same = (self.labels == self.actions).reshape(len(self), -1).all(axis=1)
        intended: NDArray[np.bool_] = self.is_demonstrated & same
        return intended

    @property
    def action_space(self) -> ActionSpaceName:
        """The kind of actions that it has."""
        return spec_of(self.actions).name

    def with_action_space(self, name: ActionSpaceName) -> "Trajectory":
        """The same episode with actions of another kind, which produce the same motions.

        Raises:
            TrajectoryError: some continuous actions are not among the 18 discrete ones.
            UnknownNameError: there is no such action space.
        """
        spec = action_spec(name)
        if self.action_space == name:
            return self
        columns = {each: getattr(self, each) for each in _ACTIONS}
        try:
            converted: dict[str, Any] = {
                each: spec.convert(column) for each, column in columns.items() if column is not None
            }
        except InvalidActionError as error:
            raise TrajectoryError(f"{self.env_id}: {error}") from error
        return replace(self, **converted)

    @property
    def task(self) -> Task:
        """The task that was demonstrated."""
        return self.env_id.task_spec

    @property
    def is_recovered(self) -> bool:
        """Whether poses were recovered from frames, so the simulation does not reproduce them."""
        return self.poses is not None and RECOVERY in self.metadata

    def _checked_actors(self, actors: ArrayLike) -> NDArray[np.uint8]:
        array = np.asarray(actors)
        if array.shape != (len(self),) or not np.isin(array, list(Actor)).all():
            raise TrajectoryError(
                f"actors: expected numbers of {', '.join(map(str.lower, Actor.__members__))}, one "
                f"for each of {len(self.actions)} actions, found {array.dtype} {array.shape}"
            )
        return _frozen(array.astype(np.uint8))

    def _checked_bodies(
        self, name: str, limits: tuple[float, float, float], values: ArrayLike
    ) -> NDArray[np.float64]:
        steps, blocks = len(self.actions), len(self.scene.blocks)
        shape, why = (steps + 1, FIRST_BLOCK + blocks, 3), f"for {steps} actions, {blocks} blocks"
        array = _checked_array(name, values, "float64", shape, why)
        if not (np.abs(array) <= limits).all():
            raise TrajectoryError(
                f"{name}: expected finite x, y and angles of at most {limits}, "
                f"found {np.abs(array).max(axis=(0, 1))}"
            )
        return array

    def _checked_frames(self, frames: Mapping[str, Any]) -> dict[str, NDArray[np.uint8]]:
        if not frames or not set(map(str, frames)) <= set(VIEWS):
            raise TrajectoryError(f"frames: expected views of {VIEWS}, found {sorted(frames)}")
        shape = (len(self.actions) + 1, FRAME_SIZE, FRAME_SIZE, 3)
        why = f"(one more than the {len(self.actions)} actions)"
        return {
            str(view): _checked_array(f"{view} frames", frames[view], "uint8", shape, why)
            for view in sorted(frames)
        }


def _checked_array(
    name: str, value: ArrayLike, dtype: str, shape: tuple[int, ...], why: str
) -> NDArray[Any]:
    array = np.asarray(value)
    if array.shape != shape or array.dtype != dtype:
        raise TrajectoryError(
            f"{name}: expected {dtype} {shape} {why}, found {array.dtype} {array.shape}"
        )
    return _frozen(array)


def _frozen(array: NDArray[Any]) -> NDArray[Any]:
    copied = array.copy() if array.flags.writeable or not array.flags.c_contiguous else array
    copied.flags.writeable = False
    return copied


def stored_env_id(value: Any) -> EnvId:
    """Parse an environment id from a file; one that names a module is refused, never imported.

    Raises:
        TrajectoryError: the value is not a string of letters, digits, `_`, `-` and `/`.
        UnknownNameError: there is no such environment.
    """
    if not isinstance(value, str) or not _ENV_ID.fullmatch(value):
        raise TrajectoryError(f"expected an environment id, found {quoted(value)}")
    return parse_env_id(value).without_preset


def checked_score(name: str, value: Any) -> float:
    """The value as a score; raises `TrajectoryError` unless it is a number from 0 to 1."""
    if not isinstance(value, int | float) or not 0.0 <= value <= 1.0:
        raise TrajectoryError(f"{name}: expected a number from 0 to 1, found {quoted(value)}")
    return float(value)


def checked_actions(
    name: str, actions: ArrayLike, ndim: int = 1, count: int | None = None
) -> Actions:
    """Checked, read-only actions (T,), or (T, 3) if `ndim` is 2; raises `TrajectoryError`."""
    rows = len(np.atleast_1d(actions)) if count is None else count
    if not rows:
        raise TrajectoryError(f"{name}: expected at least one, found none")
    try:
        return _frozen((CONTINUOUS if ndim == 2 else DISCRETE).checked_batch(actions, rows, name))
    except InvalidActionError as error:
        raise TrajectoryError(str(error)) from error


def _checked_seed(seed: Any) -> int:
    whole = isinstance(seed, int | np.integer) and not isinstance(seed, bool)
    if not whole or not 0 <= seed < 1 << MAX_BITS:
        raise TrajectoryError(
            f"seed: expected an integer from 0, of {MAX_BITS} bits at most, found {quoted(seed)}"
        )
    return int(seed)


def _checked_metadata(metadata: Mapping[str, Any]) -> dict[str, Any]:
    try:
        plain: dict[str, Any] = json.loads(json.dumps(dict(metadata), allow_nan=False))
        check_plain({"metadata": plain})  # as in a file's header
    except (TypeError, ValueError, RecursionError) as error:
        raise TrajectoryError(f"metadata: expected plain JSON data, found {error}") from error
    return plain
