"""An episode that a person plays, with all that is needed to store it."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from magical.demos.record import recorded_trajectory
from magical.demos.store.trajectory import Trajectory
from magical.envs.env import MagicalEnv
from magical.envs.ids import EnvId
from magical.envs.keys import Control, controls_of


class PlayedEpisode:
    """An episode from its reset to its last step, with all poses."""

    def __init__(self, env_id: EnvId, seed: int) -> None:
        self.env_id = env_id
        self.seed = seed
        self.env = MagicalEnv(env_id.task, env_id.variant, observation="state")
        self.env.reset(seed=seed)
        self.poses: list[NDArray[np.float64]] = []
        self.executed: Sequence[Control] | None = None  # in the last step; None: none yet
        self._note_poses()

    def step(self, action: int) -> bool:
        """Step the environment; returns whether that was the last step."""
        truncated = self.env.step(action)[3]
        self.executed = controls_of(action)
        self._note_poses()
        return truncated

    def _note_poses(self) -> None:
        self.poses.append(self.env.state().poses.bodies.copy())

    @property
    def steps(self) -> int:
        """Control steps so far."""
        return len(self.poses) - 1

    def trajectory(self, demonstrator: str, view: str) -> Trajectory:
        """The episode as a demonstration by the person of that name, who saw that view last."""
        return recorded_trajectory(
            self.env,
            self.poses,
            seed=self.seed,
            demonstrator=demonstrator,
            metadata={"recorder": "magical play", "view": view},
        )
