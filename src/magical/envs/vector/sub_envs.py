"""Some of a vector environment's sub-environments, stepped one after the other in one process."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode

from magical.envs.episode import Episode
from magical.envs.ids import EnvId
from magical.envs.saved_state import SavedState
from magical.envs.vector.buffers import VectorBuffers, VectorSpec
from magical.errors import InvalidSceneError, MismatchedSpacesError
from magical.observe import Observation, ObservationSpec, make_spec
from magical.observe.arrays import assign, select
from magical.scene.actions import AnyAction
from magical.scene.poses import FIRST_BLOCK
from magical.scene.scene import Scene

Started = list[tuple[int, Scene]]  # sub-environments that started an episode, and its scene
Restored = list[tuple[int, Scene, float]]  # as `Started`, with what `Episode.restore` returns
Seeds = Sequence[tuple[int, int | None]]  # sub-environments to reset, and their seeds


def common_observation(env_ids: Sequence[EnvId], observation: Observation) -> ObservationSpec:
    """The observation given, or else the preset that the ids agree on, for all of their tasks.

    Raises `MismatchedSpacesError` if the ids disagree, or for state vectors of different lengths.
    """
    presets = {env_id.preset for env_id in env_ids}
    if observation is None and len(presets) > 1:
        raise MismatchedSpacesError(
            "environments in one batch: expected the same preset in all ids, found "
            f"{', '.join(sorted(map(str, presets)))}; or give observation=..."
        )
    chosen = presets.pop() if observation is None else observation
    first, *others = {env_id.task: env_id.task_spec for env_id in env_ids}.values()
    spec = make_spec(chosen, first)
    for task in others:
        other = make_spec(chosen, task)
        if other.space != spec.space:
            raise MismatchedSpacesError(
                "environments in one batch: expected one observation space, found "
                f"shape {spec.space.shape} ({first.name}) and {other.space.shape} "
                f"({task.name}); use a pixel observation or a batch for each task"
            )
    return spec


class SubEnvs:
    """The sub-environments in `rows` of a vector environment, writing to its buffers.

    Actions are read from the buffers; everything else is written there. Arguments are checked by
    the vector environment, not here.
    """

    def __init__(self, spec: VectorSpec, rows: Sequence[int], buffers: VectorBuffers) -> None:
        self._envs = {row: _SubEnv(spec, row, buffers) for row in rows}
        self._in_order = list(self._envs.values())
        self._same_step = spec.autoreset_mode is AutoresetMode.SAME_STEP
        part = slice(rows[0], rows[-1] + 1)
        self._actions, self._active = buffers.actions[part], buffers.active[part]
        self._steps = buffers.steps[part]
        self._copy_to = buffers.copy_to
        self._ends = (buffers.rewards[part], buffers.truncations[part], buffers.scores[:, part])

    def step(self) -> Started:
        """Act in every active sub-environment; reset those whose episode ended."""
        started: Started = []
        for array in self._ends:
            array.fill(0)
        np.add(self._steps, 1, out=self._steps, where=self._active)
        copy = int(self._copy_to[0])
        columns = self._in_order, self._active.tolist(), self._actions.tolist()
        for env, is_active, action in zip(*columns, strict=True):
            try:
                if is_active and self._advance(env, action):
                    started.append(env.reset())
            except Exception as error:
                error.add_note(f"in {env.name}")
                raise
            if copy >= 0:
                env.copy_observation(copy)
        return started

    def _advance(self, env: "_SubEnv", action: AnyAction) -> bool:
        """Act unless the episode has ended; returns whether to start another."""
        if env.ended:
            return True
        if not env.step(action) or not self._same_step:
            return False
        env.keep_final_observation()
        return True

    def reset(self, seeds: Seeds, options: Mapping[str, Any] | None) -> Started:
        """Start episodes in the given sub-environments, each with its seed."""
        started: Started = []
        for row, seed in seeds:
            env = self._envs[row]
            try:
                started.append(env.reset(seed, options))
            except Exception as error:
                error.add_note(f"in {env.name}")
                raise
        return started

    def get_state(self, row: int) -> dict[str, Any]:
        """What `MagicalEnv.get_state` returns."""
        env = self._envs[row]
        return env.episode.save(env.rng)

    def set_state(self, row: int, state: SavedState) -> Restored:
        """Continue from a saved state; raises `InvalidStateError`."""
        return [self._envs[row].restore(state)]

    def close(self) -> None:
        """Release the sub-environments."""
        self._envs.clear()
        self._in_order.clear()


class _SubEnv:
    """One sub-environment and its row in the buffers."""

    def __init__(self, spec: VectorSpec, row: int, buffers: VectorBuffers) -> None:
        env_id = spec.env_ids[row]
        self._observation = select(buffers.observations, row)
        self._copies = [select(copy, row) for copy in buffers.copies]
        self.name = f"environment {row} ({env_id})"
        self.episode = Episode(
            env_id.task_spec,
            env_id.variant,
            spec.observation,
            spec.horizon,
            spec.reward,
            self._observation,
        )
        self.rng, _ = seeding.np_random()
        self.ended = False  # the next step starts another episode
        self._row = row
        self._buffers = buffers
        self._always_rewarded = spec.reward not in ("none", "score")
        self._bodies = buffers.bodies[row]

    def step(self, action: AnyAction) -> bool:
        """Act; returns whether the episode has ended."""
        episode = self.episode
        self.ended = episode.step(action)
        self._bodies[:] = episode.bodies
        if self.ended or self._always_rewarded:
            row, buffers = self._row, self._buffers
            buffers.rewards[row], scores = episode.outcome(self.ended)
            buffers.truncations[row] = self.ended
            buffers.scores[:, row] = scores.score, scores.published_code
        return self.ended

    def reset(
        self, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[int, Scene]:
        """Start an episode as `MagicalEnv.reset` does."""
        if seed is not None:
            self.rng, _ = seeding.np_random(seed)
        self.ended = True  # in case the start fails
        self.episode.start(self.rng, options)
        return self._started()

    def restore(self, state: SavedState) -> tuple[int, Scene, float]:
        """Continue as `MagicalEnv.set_state` does."""
        departure = self.episode.restore(state)
        state.restore_rng(self.rng)
        return *self._started(), departure

    def keep_final_observation(self) -> None:
        """Copy the last observation, which the next episode's first one would overwrite."""
        assign(select(self._buffers.final_observations, self._row), self._observation)

    def copy_observation(self, copy: int) -> None:
        """Copy the observation to the array that is handed out to the caller."""
        assign(self._copies[copy], self._observation)

    def _started(self) -> tuple[int, Scene]:
        row, buffers, episode = self._row, self._buffers, self.episode
        scene, count = episode.simulation.scene, len(episode.bodies)
        if count > buffers.bodies.shape[1]:
            raise InvalidSceneError(
                f"{self.name}: expected at most {buffers.bodies.shape[1] - FIRST_BLOCK} blocks, "
                f"found {len(scene.blocks)}; remove some"
            )
        self.ended = len(episode.actions) >= episode.horizon
        self._bodies = buffers.bodies[row, :count]
        self._bodies[:] = episode.bodies
        buffers.body_counts[row] = count
        buffers.steps[row], buffers.horizons[row] = len(episode.actions), episode.horizon
        return row, scene
