"""Gymnasium's vector environment, over worker processes."""

import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from threading import Lock
from typing import Any, NoReturn

import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from magical.envs.action_spec import ActionSpaceName, action_spec
from magical.envs.env import SCORE_KEYS, MagicalEnv, not_picklable
from magical.envs.episode import Reward
from magical.envs.ids import EnvId, parse_env_id
from magical.envs.saved_state import parse_state, warn_of_departure
from magical.envs.vector.buffers import Copies, SharedMemory, VectorBuffers, VectorSpec
from magical.envs.vector.checks import (
    check_no_time_limit,
    check_timeout,
    checked_mask,
    checked_seeds,
    parse_autoreset_mode,
    require_episodes,
)
from magical.envs.vector.sub_envs import Started, SubEnvs, common_observation
from magical.envs.vector.workers import RemoteSubEnvs
from magical.errors import (
    AlreadyPendingCallError,
    ClosedEnvironmentError,
    ForkedEnvironmentError,
    UnknownNameError,
    WorkerDiedError,
    WorkerTimeoutError,
)
from magical.messages import quoted
from magical.observe import Observation
from magical.observe.arrays import copy_arrays, select
from magical.processes import checked_workers
from magical.scene.poses import Poses, State
from magical.scene.scene import Scene
from magical.tasks import Horizon
from magical.tasks.scoring import SUCCESS

Bools = NDArray[np.bool_]
Infos = dict[str, Any]
_CLOSING = (WorkerDiedError, WorkerTimeoutError)  # errors after which the environment is closed


class MagicalVectorEnv(VectorEnv[Any, Any, NDArray[Any]]):
    """N sub-environments, of one or of several tasks and variants, stepped together.

    Sub-environment i behaves, to the last bit, like a `MagicalEnv` for `env_ids[i]` with the same
    reset seed and the same actions, whatever the number of workers. Observations
    are batched as Gymnasium batches them; `infos` holds `eval_score`, `published_code_score` and
    `is_success`, 0.0 and False before an episode's last step, as arrays with their masks, and the
    `instruction` of each sub-environment that starts an episode.

    Args:
        env_ids: the sub-environments' ids, with or without a preset.
        workers: processes that the sub-environments are divided among, at most one for each; 0
            steps them in this process; None starts one for each core. Workers are fresh
            interpreters and never import the main script. If one ends, the next call raises
            `WorkerDiedError`. Only one thread of the process that made them may use it at a time.
        observation: see `observe.make_spec`; takes precedence over the ids' preset.
        horizon: as for `MagicalEnv`.
        reward: as for `MagicalEnv`.
        action_space: as for `MagicalEnv`.
        autoreset_mode: what happens after an episode's last step, an `AutoresetMode` or its value.
            "NextStep": the next step ignores the action and starts another episode. "SameStep":
            that step already returns the next episode's first observation; the last observation
            and scores are in `infos["final_obs"]` and `infos["final_info"]`. "Disabled": nothing,
            until `reset(seed=..., options={"reset_mask": ended})`.
        copy: whether the caller owns returned observations; otherwise they are the
            buffers' own arrays, which the next step or reset overwrites. With workers, images are
            in memory that a forked child shares: copy what you pass to one.
        render_mode: "rgb_array" or None.
        timeout: seconds in which the workers must finish a step, a reset or a call of `get_state`
            or `set_state`; otherwise `WorkerTimeoutError` is raised and the environment is closed.
            By default there is no limit. Not available on Windows or without workers.

    Raises:
        UnknownNameError: an unknown id, observation, reward, action space, autoreset mode or render
            mode.
        ValueError: no ids, or an invalid number of workers or timeout.
        InvalidConfigError, ObservationError: an invalid horizon or observation.
        MismatchedSpacesError: sub-environments whose observation spaces differ.
        InvalidTaskError: a task that workers cannot import.
    """

    def __init__(
        self,
        env_ids: Sequence[str],
        *,
        workers: int | None = None,
        observation: Observation = None,
        horizon: Horizon = None,
        reward: Reward = "none",
        action_space: ActionSpaceName = "discrete",
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        copy: bool = True,
        render_mode: str | None = None,
        timeout: float | None = None,
    ) -> None:
        if isinstance(env_ids, str) or not (env_ids := tuple(env_ids)):
            raise ValueError(
                f"env_ids: expected a list of environment ids, found {quoted(env_ids)}"
            )
        if render_mode not in (None, "rgb_array"):
            raise UnknownNameError(f"render mode {quoted(render_mode)}: expected rgb_array or None")
        parsed = [parse_env_id(env_id) for env_id in env_ids]
        self.env_ids = tuple(env_id.without_preset for env_id in parsed)
        self.autoreset_mode = parse_autoreset_mode(autoreset_mode)
        modes = {"render_modes": ["rgb_array"], "autoreset_mode": self.autoreset_mode}
        self.metadata = {**MagicalEnv.metadata, **modes}
        self.copy, self.render_mode = copy, render_mode
        common = common_observation(parsed, observation)
        self.action_spec = action_spec(action_space)
        spec = VectorSpec(
            self.env_ids, common, horizon, reward, self.autoreset_mode, copy, self.action_spec
        )
        self._set_spaces(common.space)
        self._running = np.zeros(self.num_envs, np.bool_)
        self._scenes: list[Scene | None] = [None] * self.num_envs
        self._lock = Lock()  # held by the call in progress
        self._pending = ""  # its name
        self._process_id = os.getpid()
        self._sub_envs: SubEnvs | RemoteSubEnvs
        self.workers = min(checked_workers(workers), self.num_envs)
        check_timeout(timeout, self.workers)
        self._make_sub_envs(spec, timeout)

    def _make_sub_envs(self, spec: VectorSpec, timeout: float | None) -> None:
        if self.workers:
            memory = SharedMemory(spec.size)
            self._buffers = VectorBuffers(spec, memory.memory)
            self._sub_envs = RemoteSubEnvs(spec, self.workers, memory, timeout)
        else:
            self._buffers = VectorBuffers(spec)
            self._sub_envs = SubEnvs(spec, range(self.num_envs), self._buffers)
        self._copies = Copies(self._buffers)

    def _set_spaces(self, single: spaces.Space[Any]) -> None:
        self.num_envs = len(self.env_ids)
        self.single_observation_space = single
        self.observation_space = batch_space(single, self.num_envs)
        self.single_action_space = self.action_spec.space
        self.action_space = batch_space(self.single_action_space, self.num_envs)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Any, Infos]:
        """Start an episode in every sub-environment, or where `options["reset_mask"]` is True.

        Args:
            seed: sub-environment i gets `seed + i`, or `seed[i]` of a list; None continues with
                each one's own random generator.
            options: `reset_mask`, bool (N,); `scene`, `dynamics` and `nudge` as for `MagicalEnv`.

        Returns:
            All observations, and `infos` masked to the sub-environments that were reset.

        Raises:
            InvalidSceneError, PlacementError: no episode can start from these.
            WorkerDiedError, WorkerTimeoutError: the environment is closed.
        """
        with self._call("reset"):
            chosen = dict(options or {})
            mask = checked_mask("reset_mask", chosen.pop("reset_mask", None), self.num_envs)
            seeds = checked_seeds(seed, self.num_envs)
            super().reset(seed=seed if isinstance(seed, int) else None)
            rows = np.flatnonzero(mask).tolist()
            wanted = [(row, seeds[row]) for row in rows]
            started = self._exchange(lambda: self._sub_envs.reset(wanted, chosen), rows)
            self._start(started)
            infos = _score_infos(np.zeros((2, self.num_envs)), mask)
            return self._observations(-1), infos | self._instructions(started)

    def step(
        self, actions: Any, active: Bools | None = None
    ) -> tuple[Any, NDArray[np.float64], Bools, Bools, Infos]:
        """Act in every sub-environment for one control step of 1/8 s.

        Args:
            actions: integers (N,), each from 0 to 17; continuous ones (N, 3), each from -1 to 1.
            active: bool (N,); where it is False nothing changes, and `infos` masks the
                sub-environment out. By default all are active.

        Raises:
            InvalidActionError: actions of a wrong shape, type or range; nothing has changed.
            ResetNeededError: a sub-environment has no running episode; nothing has changed.
            WorkerDiedError, WorkerTimeoutError: the environment is closed.
        """
        with self._call("step"):
            acting = checked_mask("active", active, self.num_envs)
            require_episodes("step", self._running | ~acting, self.env_ids)
            self._buffers.actions[:] = self.action_spec.checked_batch(actions, self.num_envs)
            self._buffers.active[:] = acting
            copy = self._buffers.copy_to[0] = self._copies.choose()
            started = self._exchange(self._sub_envs.step, range(self.num_envs))
            self._start(started)
            truncations = self._buffers.truncations.copy()
            if self.autoreset_mode is AutoresetMode.DISABLED:
                self._running[truncations] = False
            infos = self._infos(acting, truncations) | self._instructions(started)
            terminations = np.zeros(self.num_envs, np.bool_)
            rewards = self._buffers.rewards.copy()
            return self._observations(copy), rewards, terminations, truncations, infos

    def _instructions(self, started: Started) -> Infos:
        """The instructions of the sub-environments that have started an episode."""
        if not started:
            return {}
        words, mask = np.full(self.num_envs, None, dtype=object), np.zeros(self.num_envs, np.bool_)
        for row, scene in started:
            task, mask[row] = self.env_ids[row].task_spec, True
            words[row] = task.instruction(scene)
        return {"instruction": words, "_instruction": mask}

    def states(self) -> list[State]:
        """The true state of every sub-environment, for experts and privileged policies."""
        self._require_episodes("states")
        bodies = self._buffers.bodies.copy()
        counts, steps = self._buffers.body_counts.tolist(), self._buffers.steps.tolist()
        horizons = self._buffers.horizons.tolist()
        return [
            State(scene, Poses(bodies[i, :n, :3]), bodies[i, :n, 3:], steps[i], horizons[i])
            for i, (scene, n) in enumerate(zip(self._scenes, counts, strict=True))
            if scene is not None
        ]

    @property
    def bodies(self) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """All bodies as (N, max bodies, 6): x, y, angle and their velocities.

        The rows are those of `Poses`; the second array, (N,), holds how many are in use. Both are
        read-only views of the buffers, which the next step or reset overwrites.
        """
        self._require_episodes("bodies")
        bodies, counts = self._buffers.bodies.view(), self._buffers.body_counts.view()
        bodies.flags.writeable = counts.flags.writeable = False
        return bodies, counts

    @property
    def worker_process_ids(self) -> list[int]:
        """The worker processes' ids; none for `workers=0` and after closing."""
        sub_envs = getattr(self, "_sub_envs", None)
        return sub_envs.process_ids if isinstance(sub_envs, RemoteSubEnvs) else []

    def get_state(self, index: int) -> dict[str, Any]:
        """What `MagicalEnv.get_state` returns, for sub-environment `index`."""
        with self._call("get_state"):
            self._require_episodes("get_state", index)
            row = range(self.num_envs)[index]
            state: dict[str, Any] = self._exchange(lambda: self._sub_envs.get_state(row))
            return state

    def set_state(self, index: int, state: Mapping[str, Any]) -> Any:
        """Continue sub-environment `index` from a saved state, as `MagicalEnv.set_state` does.

        Args:
            index: which sub-environment.
            state: what `get_state` returned, in this or another process.

        Returns:
            The sub-environment's observation.

        Raises:
            InvalidStateError: data of another task, or damaged; the sub-environment needs a reset.
        """
        with self._call("set_state"):
            row = range(self.num_envs)[index]
            task = self.env_ids[row].task_spec
            ((_, scene, departure),) = self._exchange(
                lambda: self._sub_envs.set_state(row, parse_state(state, task, self.action_spec)),
                [row],
            )
            self._start([(row, scene)])
            warn_of_departure(departure)
            return copy_arrays(select(self._buffers.observations, index))

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """Both views of every sub-environment side by side: N arrays (384, 768, 3), or None."""
        if self.render_mode is None:
            return None
        from magical.render import render_views  # imports numba: only when something is rendered

        return tuple(render_views(state.scene, state.poses) for state in self.states())

    def __reduce__(self) -> NoReturn:
        raise not_picklable("MagicalVectorEnv", "MagicalVectorEnv(env_ids, ...)")

    def close_extras(self, **kwargs: Any) -> None:
        """End the workers, which are killed if they take more than two seconds."""
        if hasattr(self, "_sub_envs"):
            self._sub_envs.close()
            del self._sub_envs, self._buffers, self._copies

    @contextmanager
    def _call(self, name: str) -> Iterator[None]:
        """Refuse a call that cannot be made now; other calls are refused until it has ended.

        Every call writes to the arrays.
        """
        self._require_open(name)
        if not self._lock.acquire(blocking=False):
            raise AlreadyPendingCallError(
                f"{name}: expected no call in progress, found a pending call of {self._pending}; "
                "use a vector environment from one thread at a time, or one for each thread"
            )
        try:
            self._pending = name
            yield
        finally:
            self._lock.release()

    def _start(self, started: Started) -> None:
        for row, scene in started:
            self._scenes[row] = scene
            # Only a restored state can be at its episode's end.
            ended = self._buffers.steps[row] >= self._buffers.horizons[row]
            self._running[row] = not (ended and self.autoreset_mode is AutoresetMode.DISABLED)

    def _infos(self, acting: Bools, ended: Bools) -> Infos:
        """The infos of a step, as Gymnasium's own vector environments build them."""
        scores = self._buffers.scores
        if self.autoreset_mode is not AutoresetMode.SAME_STEP or not ended.any():
            return _score_infos(scores.copy(), acting)
        observations = np.full(self.num_envs, None, dtype=object)
        for row in np.flatnonzero(ended).tolist():
            observations[row] = copy_arrays(select(self._buffers.final_observations, row))
        return {
            **_score_infos(np.zeros_like(scores), acting),
            "final_obs": observations,
            "_final_obs": ended.copy(),
            "final_info": _score_infos(np.where(ended, scores, 0.0), ended),
            "_final_info": ended.copy(),
        }

    def _observations(self, copy: int) -> Any:
        return self._copies.hand_out(copy) if self.copy else self._buffers.observations

    def _exchange(self, call: Callable[[], Any], rows: Iterable[int] = ()) -> Any:
        """Call the sub-environments; if that fails, those in `rows` need a reset."""
        try:
            return call()
        except BaseException as error:
            for row in rows:
                self._running[row], self._scenes[row] = False, None
            if not isinstance(error, Exception) or isinstance(error, _CLOSING):
                self.close()  # an interrupted exchange cannot be continued
            raise

    def _require_open(self, what: str) -> None:
        if self.closed:
            raise ClosedEnvironmentError(
                f"{what}: expected an open environment, found a closed one; make a new one"
            )
        if self.workers and os.getpid() != self._process_id:
            raise ForkedEnvironmentError(
                f"{what}: expected to be called in process {self._process_id}, which made the "
                f"environment and shares its workers' memory, found process {os.getpid()}, a fork; "
                "make another vector environment there"
            )

    def _require_episodes(self, what: str, index: int | None = None) -> None:
        self._require_open(what)
        running = np.array([scene is not None for scene in self._scenes])
        if index is not None:
            running[np.arange(self.num_envs) != range(self.num_envs)[index]] = True
        require_episodes(what, running, self.env_ids)


def _score_infos(scores: NDArray[np.float64], mask: Bools) -> Infos:
    """Scores (2, N) and success under their names, each with its mask (N,), as in Gymnasium."""
    values = dict(zip(SCORE_KEYS, scores, strict=True)) | {"is_success": scores[0] > SUCCESS}
    return values | {f"_{key}": mask.copy() for key in values}


def make_vector_env(task: str, variant: str, num_envs: int = 1, **options: Any) -> MagicalVectorEnv:
    """The entry point of `gymnasium.make_vec("magical/<id>", num_envs=N, ...)`.

    `options` are those of `MagicalVectorEnv`: observation, workers, horizon, reward, copy, ...
    """
    check_no_time_limit(options)
    return MagicalVectorEnv([EnvId(task, variant)] * num_envs, **options)
