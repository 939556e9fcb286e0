"""Gymnasium's vector environment: many environments, stepped together by threads."""

import operator
import os
import sys
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import suppress
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space, create_empty_array
from numpy.typing import NDArray

from magical.envs.env import SCORE_KEYS, MagicalEnv, known, time_limit_error
from magical.envs.ids import EnvId, parse_env_id
from magical.errors import (
    InvalidSceneError,
    ObservationError,
    ResetNeededError,
)
from magical.messages import quoted
from magical.observe import Observation, copy_arrays, map_arrays, select
from magical.processes import checked_workers
from magical.scene import FIRST_BLOCK, State
from magical.tasks.scoring import SUCCESS

Bools = NDArray[np.bool_]
Rows = NDArray[np.int64]
Infos = dict[str, Any]


class MagicalVectorEnv(VectorEnv[Any, Any, NDArray[Any]]):
    """N sub-environments, of one or of several tasks and variants, stepped together.

    Sub-environment i behaves, to the last bit, like a `MagicalEnv` for `env_ids[i]` with the same
    reset seed and the same actions, whatever the number of workers. Observations
    are batched as Gymnasium batches them; `infos` holds `eval_score`, `published_code_score` and
    `is_success`, 0.0 and False before an episode's last step, as arrays with their masks, and the
    `instruction` of each sub-environment that starts an episode.

    Args:
        env_ids: the sub-environments' ids, with or without a preset.
        workers: threads that the sub-environments are divided among, one of which is the caller's;
            None takes one for each core. More than about four gain little, because what is Python
            is done by one at a time: on more cores, start several processes.
        observation: see `observe.make_spec`; takes precedence over the ids' preset.
        autoreset_mode: what happens after an episode's last step, an `AutoresetMode` or its value.
            "NextStep": the next step ignores the action and starts another episode. "SameStep":
            that step already returns the next episode's first observation; the last observation
            and scores are in `infos["final_obs"]` and `infos["final_info"]`. "Disabled": nothing,
            until `reset(seed=..., options={"reset_mask": ended})`.
        copy: whether the caller owns returned observations; otherwise they are the environment's
            own arrays, which the next step or reset overwrites.
        options: `horizon`, `reward`, `render_mode` and `action_space`, as for `MagicalEnv`.

    Raises:
        UnknownNameError: an unknown id or autoreset mode.
        ValueError: no ids, or an invalid number of workers.
        ObservationError: sub-environments whose observation spaces differ.
        MagicalError: what `MagicalEnv` refuses.
    """

    def __init__(
        self,
        env_ids: Sequence[str],
        *,
        workers: int | None = None,
        observation: Observation = None,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        copy: bool = True,
        **options: Any,
    ) -> None:
        if isinstance(env_ids, str) or not (env_ids := tuple(env_ids)):
            raise ValueError(
                f"env_ids: expected a list of environment ids, found {quoted(env_ids)}"
            )
        parsed = list(map(parse_env_id, env_ids))
        self.env_ids = tuple(env_id.without_preset for env_id in parsed)
        self.num_envs = count = len(parsed)
        self.workers = min(max(1, checked_workers(workers)), count)
        modes = [mode.value for mode in AutoresetMode]
        mode = getattr(autoreset_mode, "value", autoreset_mode)
        self.autoreset_mode = AutoresetMode(known("autoreset mode", mode, modes))
        self.metadata = {**MagicalEnv.metadata, "autoreset_mode": self.autoreset_mode}
        chosen = _common_preset(parsed) if observation is None else observation
        self.envs = [
            MagicalEnv(env_id.task, env_id.variant, observation=chosen, **options)
            for env_id in parsed
        ]
        _check_spaces(self.envs)
        self.render_mode, self.action_spec = self.envs[0].render_mode, self.envs[0].action_spec
        self.single_action_space = self.action_spec.space
        self.action_space = batch_space(self.single_action_space, count)
        self.single_observation_space = self.envs[0].observation_space
        self.observation_space = batch_space(self.single_observation_space, count)
        spec = self.envs[0].observation_spec
        self._observations: Any = create_empty_array(self.single_observation_space, count)
        for row, env in enumerate(self.envs):
            env.observer = spec.observer(select(self._observations, row))
        self._copies: list[_Copy] | None = [] if copy else None
        # For `substeps.step_rows`: a row is written when its episode starts.
        most = FIRST_BLOCK + max(env.task.max_blocks for env in self.envs)
        self._robots = np.zeros((count, 8), np.int64)
        self._places = np.zeros((count, most, 2), np.int64)
        self._bodies = np.zeros((count, most, 6))
        self._used_bodies = list(self._bodies)  # without the padding
        self._counts = np.zeros(count, np.int64)
        self._ended = np.zeros(count, np.bool_)  # the episode is over
        self._threads: tuple[int, ThreadPoolExecutor] | None = None  # of which process

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
            options: `reset_mask`, bool (N,); `scene` and `dynamics` as for `MagicalEnv`, or a list
                of N of them.

        Returns:
            All observations, and `infos` masked to the sub-environments that were reset.

        Raises:
            InvalidSceneError, PlacementError: no episode can start from these.
        """
        chosen = dict(options or {})
        mask = self._checked_mask("reset_mask", chosen.pop("reset_mask", None))
        seeds = _checked_seeds(seed, self.num_envs)
        super().reset(seed=seed if isinstance(seed, int) else None)
        words = {}
        for row in np.flatnonzero(mask).tolist():
            own = {key: _of_row(value, row) for key, value in chosen.items()}
            words[row] = self._start(row, seeds[row], own)
        infos = _score_infos(np.zeros((2, self.num_envs)), mask)
        return self._hand_out(None), infos | self._objects("instruction", words)

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
        """
        acting = self._checked_mask("active", active)
        missing = self._counts == 0
        if self.autoreset_mode is AutoresetMode.DISABLED:
            missing |= self._ended
        self._require_episodes("step", missing & acting)
        points = self.action_spec.points(actions, self.num_envs)
        try:
            return self._step(points, acting)
        except BaseException:
            self._counts[:] = 0  # some have taken the step and others have not: all need a reset
            raise

    def _step(
        self, points: NDArray[np.float64], acting: Bools
    ) -> tuple[Any, NDArray[np.float64], Bools, Bools, Infos]:
        copy = self._free_copy()
        advancing = np.flatnonzero(acting & ~self._ended)
        self._advance(points, advancing, copy)
        rewards, scores = np.zeros(self.num_envs), np.zeros((2, self.num_envs))
        truncations = np.zeros(self.num_envs, np.bool_)
        for row in advancing.tolist():
            env = self.envs[row]
            try:
                rewards[row], found = env.outcome()
            except Exception as error:
                error.add_note(self._name(row))
                raise
            if not env.is_running:
                truncations[row], scores[:, row] = True, found
        if self.autoreset_mode is AutoresetMode.SAME_STEP:
            infos, restarting = self._infos_of_ended(scores, acting, truncations), truncations
        else:
            infos, restarting = _score_infos(scores, acting), acting & self._ended
            self._ended |= truncations
        words = {row: self._start(row) for row in np.flatnonzero(restarting).tolist()}
        if copy is not None:
            for row in np.flatnonzero(restarting | ~acting).tolist():
                copy.fill(row)
        terminations = np.zeros(self.num_envs, np.bool_)
        infos |= self._objects("instruction", words)
        return self._hand_out(copy), rewards, terminations, truncations, infos

    def _advance(self, points: NDArray[np.float64], rows: Rows, copy: "_Copy | None") -> None:
        """Simulate and observe a step in some rows, divided among the threads."""
        from magical.physics.substeps import step_rows  # imports numba

        taken, envs, bodies = list(map(tuple, points.tolist())), self.envs, self._used_bodies

        def advance(part: Rows) -> None:
            step_rows(part, self._robots, self._places, points, self._bodies)
            for row in part.tolist():
                envs[row].observe(taken[row], bodies[row])
                if copy is not None:
                    copy.fill(row)

        first, *others = np.array_split(rows, self.workers)
        others = [part for part in others if len(part)]
        futures = [self._executor().submit(advance, part) for part in others]
        try:
            advance(first)
        finally:
            wait(futures)
        for future in futures:
            future.result()

    def _executor(self) -> ThreadPoolExecutor:
        """The threads, made at first use and again after a fork, which has none."""
        if self._threads is None or self._threads[0] != os.getpid():
            self._threads = os.getpid(), ThreadPoolExecutor(self.workers - 1)
        return self._threads[1]

    def _start(
        self, row: int, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> str:
        """Start an episode in a row; returns its instruction."""
        self._counts[row] = 0  # in case it fails
        try:
            words: str = self.envs[row].start(seed, options or {})["instruction"]
            self._note(row)
        except Exception as error:
            error.add_note(self._name(row))
            raise
        return words

    def _note(self, row: int) -> None:
        """Note the simulation and the bodies of an episode that has been started or restored."""
        env, most = self.envs[row], self._places.shape[1]
        count = len(env.bodies)
        if count > most:
            raise InvalidSceneError(
                f"expected at most {most - FIRST_BLOCK} blocks, found {count - FIRST_BLOCK}; "
                "remove some"
            )
        self._robots[row] = env.simulation.robot
        self._places[row] = 0
        self._places[row, :count] = env.simulation.places
        self._used_bodies[row] = self._bodies[row, :count]
        self._used_bodies[row][:] = env.bodies
        self._counts[row], self._ended[row] = count, not env.is_running

    def _name(self, row: int) -> str:
        """What is added to an error of a sub-environment."""
        return f"in environment {row} ({self.env_ids[row]})"

    def states(self) -> list[State]:
        """The true state of every sub-environment, for experts and privileged policies."""
        self._require_episodes("states", self._counts == 0)
        return [env.state() for env in self.envs]

    @property
    def bodies(self) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """All bodies as (N, max bodies, 6): x, y, angle and their velocities.

        The rows are those of `Poses`; the second array, (N,), holds how many are in use. Both are
        read-only views, which the next step or reset overwrites.
        """
        self._require_episodes("bodies", self._counts == 0)
        bodies, counts = self._bodies.view(), self._counts.view()
        bodies.flags.writeable = counts.flags.writeable = False
        return bodies, counts

    def get_state(self, index: int) -> dict[str, Any]:
        """What `MagicalEnv.get_state` returns, for sub-environment `index`."""
        return self.envs[index].get_state()

    def set_state(self, index: int, state: Mapping[str, Any]) -> Any:
        """Continue sub-environment `index` from a saved state, as `MagicalEnv.set_state` does."""
        row = range(self.num_envs)[index]
        self._counts[row] = 0  # in case it fails
        observation = self.envs[row].set_state(state)
        self._note(row)
        return observation

    def render(self) -> tuple[Any, ...] | None:
        """Both views of every sub-environment side by side: N arrays (384, 768, 3), or None."""
        return None if self.render_mode is None else tuple(env.render() for env in self.envs)

    def close_extras(self, **kwargs: Any) -> None:
        """End the threads."""
        if getattr(self, "_threads", None) is not None:
            self._executor().shutdown()

    def _infos_of_ended(self, scores: NDArray[Any], acting: Bools, ended: Bools) -> Infos:
        """The infos of a step that also starts the next episodes, as Gymnasium builds them."""
        if not ended.any():
            return _score_infos(scores, acting)
        rows = np.flatnonzero(ended).tolist()
        last = {row: copy_arrays(select(self._observations, row)) for row in rows}
        return {
            **_score_infos(np.zeros_like(scores), acting),
            **self._objects("final_obs", last),
            "final_info": _score_infos(scores, ended),
            "_final_info": ended.copy(),
        }

    def _objects(self, name: str, values: Mapping[int, Any]) -> Infos:
        """An info that some rows have, with its mask."""
        array, mask = np.full(self.num_envs, None, dtype=object), np.zeros(self.num_envs, np.bool_)
        for row, value in values.items():
            array[row], mask[row] = value, True
        return {name: array, f"_{name}": mask} if values else {}

    def _free_copy(self) -> "_Copy | None":
        """Arrays to hand the observations out in, which the caller does not hold any more."""
        if self._copies is None:
            return None
        for copy in self._copies:
            if copy.is_free():
                return copy
        copy = _Copy(self._observations, self.num_envs)
        if len(self._copies) < MOST_COPIES:
            self._copies.append(copy)
        return copy

    def _hand_out(self, copy: "_Copy | None") -> Any:
        if copy is not None:
            return copy.hand_out()
        return self._observations if self._copies is None else copy_arrays(self._observations)

    def _checked_mask(self, name: str, mask: Any) -> Bools:
        """A mask of sub-environments as bool (N,), all True for None; raises `ValueError`."""
        if mask is None:
            return np.ones(self.num_envs, np.bool_)
        array = np.asarray(mask)
        if array.shape != (self.num_envs,) or array.dtype != np.bool_ or not array.any():
            raise ValueError(
                f"{name}: expected bool ({self.num_envs},) with at least one True, found "
                f"{quoted(mask)}"
            )
        return array

    def _require_episodes(self, what: str, missing: Bools) -> None:
        """Raise `ResetNeededError`, naming the sub-environments whose episode is missing."""
        if rows := np.flatnonzero(missing).tolist():
            names = ", ".join(f"{row} ({self.env_ids[row]})" for row in rows[:5])
            raise ResetNeededError(
                f"{what}: expected a running episode in every environment, found none in "
                f"{len(rows)} of {self.num_envs}: {names}{', ...' if len(rows) > 5 else ''}; "
                "call reset() first"
            )


# The current observations, the previous ones, and those of the step in progress: training loops
# keep the first two.
MOST_COPIES = 3


class _Copy:
    """Arrays in which observations are handed out, again and again: new memory costs time.

    The threads copy each observation while it is still in the core's cache.
    """

    def __init__(self, observations: Any, count: int) -> None:
        self._arrays = copy_arrays(observations)
        self._rows = [(select(self._arrays, i), select(observations, i)) for i in range(count)]
        self._free = map_arrays(sys.getrefcount, self._arrays)

    def fill(self, row: int) -> None:
        """Copy the observation of a row."""
        map_arrays(np.copyto, *self._rows[row])

    def is_free(self) -> bool:
        """Whether no caller holds the arrays: every view of them, at any remove, refers to them."""
        return bool(map_arrays(sys.getrefcount, self._arrays) == self._free)

    def hand_out(self) -> Any:
        """Views of the arrays."""
        return map_arrays(lambda array: array[:], self._arrays)


def _common_preset(env_ids: Sequence[EnvId]) -> str | None:
    """The preset that the ids agree on; raises `ObservationError` if they do not."""
    presets = {env_id.preset for env_id in env_ids}
    if len(presets) > 1:
        raise ObservationError(
            "environments in one batch: expected the same preset in all ids, found "
            f"{', '.join(sorted(map(str, presets)))}; or give observation=..."
        )
    return presets.pop()


def _check_spaces(envs: Sequence[MagicalEnv]) -> None:
    """Raise `ObservationError` for observations of different spaces, as of state vectors."""
    first = envs[0]
    for env in {env.task.name: env for env in envs}.values():
        if env.observation_space != first.observation_space:
            raise ObservationError(
                "environments in one batch: expected one observation space, found "
                f"shape {first.observation_space.shape} ({first.task.name}) and "
                f"{env.observation_space.shape} ({env.task.name}); use a pixel observation or a "
                "batch for each task"
            )


def _of_row(value: Any, row: int) -> Any:
    """One row's scene or dynamics, of one for all rows or a list of one for each."""
    many = isinstance(value, list | tuple) and not isinstance(value[0], int | float)
    return value[row] if many else value


def _score_infos(scores: NDArray[np.float64], mask: Bools) -> Infos:
    """Scores (2, N) and success under their names, each with its mask (N,), as in Gymnasium."""
    values = dict(zip(SCORE_KEYS, scores, strict=True)) | {"is_success": scores[0] > SUCCESS}
    return values | {f"_{key}": mask.copy() for key in values}


def _checked_seeds(seed: Any, num_envs: int) -> list[int | None]:
    """One seed for each sub-environment: `seed + i`, or a list's entries; raises `ValueError`."""
    if seed is None:
        return [None] * num_envs
    with suppress(TypeError, ValueError):  # neither an integer nor a list of them
        listed = [seed + i for i in range(num_envs)] if np.ndim(seed) == 0 else list(seed)
        seeds = [None if each is None else operator.index(each) for each in listed]
        if len(seeds) == num_envs and all(each is None or each >= 0 for each in seeds):
            return seeds
    raise ValueError(
        f"seed: expected a non-negative integer, {num_envs} of them, or None, found {quoted(seed)}"
    )


def make_vector_env(task: str, variant: str, num_envs: int = 1, **options: Any) -> MagicalVectorEnv:
    """The entry point of `gymnasium.make_vec`; `options` are those of `MagicalVectorEnv`."""
    if "max_episode_steps" in options:
        raise time_limit_error(options["max_episode_steps"])
    return MagicalVectorEnv([EnvId(task, variant)] * num_envs, **options)
