"""Recording trajectories from whatever acts in an environment."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from magical.demos.store.provenance import provenance
from magical.demos.store.trajectory import Trajectory
from magical.demos.store.writer import DatasetWriter
from magical.envs.env import MagicalEnv
from magical.errors import TrajectoryError
from magical.scene import Dynamics


class RecordTrajectories(gym.Wrapper[Any, Any, Any, Any]):
    """Stores every finished episode of an environment in a dataset, made if there is none.

    It only watches, so a policy, an expert and `gymnasium.utils.play` are recorded alike; wrappers
    may lie below and above it. An episode that is reset before its end is not stored.

    Raises:
        TrajectoryError: the environment is not one of magical's; or it was taken to another state
            with `set_state` in the middle of an episode.
        DatasetError: the dataset cannot be written.
    """

    def __init__(
        self,
        env: gym.Env[Any, Any],
        dataset: Path | str,
        *,
        demonstrator: str,
        min_score: float | None = None,
        metadata: Mapping[str, Any] | None = None,
    ) -> None:
        """Watch `env`; with `min_score` worse episodes are left out (by the appendix's rule)."""
        super().__init__(env)
        inner = env.unwrapped
        if not isinstance(inner, MagicalEnv):
            raise TrajectoryError(f"expected one of magical's environments, found {inner}")
        self._inner = inner
        self._writer = DatasetWriter(dataset)
        self._demonstrator = demonstrator
        self._min_score = min_score
        self._remarks = dict(metadata or {})
        self._poses: list[NDArray[np.float64]] = []
        self._seed: int | None = None
        self.recorded = 0  # episodes stored so far

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin an episode, and its recording."""
        result = super().reset(seed=seed, options=options)
        self._seed = seed
        self._poses = [self._inner.state().poses.bodies.copy()]
        return result

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Act; at the end of the episode, store it."""
        result = super().step(action)
        self._poses.append(self._inner.state().poses.bodies.copy())
        if result[2] or result[3]:
            self._store()
        return result

    def _store(self) -> None:
        saved, poses = self._inner.get_state(), np.stack(self._poses)
        if len(poses) != len(saved["actions"]) + 1:
            raise TrajectoryError("the episode was not recorded from its start; reset() first")
        scores = self._inner.scores()
        if self._min_score is not None and scores.score < self._min_score:
            return
        self._writer.append(
            Trajectory(
                env_id=self._inner.env_id,
                scene=self._inner.state().scene,
                dynamics=Dynamics.from_dict(saved["dynamics"]),
                actions=np.array(saved["actions"]),
                poses=poses,
                score=scores.score,
                published_code_score=scores.published_code,
                seed=self._seed,
                demonstrator=self._demonstrator,
                metadata={**provenance(), **self._remarks},
            )
        )
        self.recorded += 1
