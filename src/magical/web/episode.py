"""An episode that a person plays, with all that is needed to store it."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from magical.demos.record import recorded_trajectory
from magical.demos.store.trajectory import Actor, Trajectory
from magical.envs.env import MagicalEnv
from magical.envs.ids import EnvId
from magical.scene import State

RECORDER = "magical play"  # in the metadata of episodes


class PlayedEpisode:
    """An episode from its reset to its last step, with all poses."""

    def __init__(self, env_id: EnvId, seed: int) -> None:
        self.env_id = env_id
        self.seed = seed
        self.env = MagicalEnv(env_id.task, env_id.variant, observation="state")
        self.env.reset(seed=seed)
        self.poses: list[NDArray[np.float64]] = []
        self.last_action: int | None = None
        self.actors: list[Actor] = []  # who chose each action
        self.policy_actions: list[int] = []  # of the policy that is watched, if any
        self._note_poses()

    def step(self, action: int, actor: Actor, chosen: int | None = None) -> bool:
        """Step the environment; returns whether that was the last step.

        Args:
            action: that is executed.
            actor: who chose it.
            chosen: what the policy that is watched chose, if one is.
        """
        self.actors.append(actor)
        if chosen is not None:
            self.policy_actions.append(chosen)
        self.last_action = action
        truncated = self.env.step(action)[3]
        self._note_poses()
        return truncated

    def _note_poses(self) -> None:
        self.poses.append(self.env.state().poses.bodies)

    @property
    def seen(self) -> tuple[State, int | None]:
        """The present state, and the action that led to it."""
        return self.env.state(), self.last_action

    @property
    def steps(self) -> int:
        """Control steps so far."""
        return len(self.poses) - 1

    def trajectory(self, demonstrator: str, view: str, policy: str | None = None) -> Trajectory:
        """The episode as a demonstration.

        Args:
            demonstrator: the name of the person who acted.
            view: what that person saw last.
            policy: the name of the policy that was watched, if one was.
        """
        metadata = {"recorder": RECORDER, "view": view}
        trajectory = recorded_trajectory(
            self.env,
            self.poses,
            seed=self.seed,
            demonstrator=demonstrator,
            metadata=metadata if policy is None else {**metadata, "policy": policy},
        )
        if policy is None:
            return trajectory
        return replace(
            trajectory,
            actors=np.array(self.actors, np.uint8),
            policy_actions=np.array(self.policy_actions),
        )
