"""An episode being played, with all data needed to store it."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from magical.demos.record import recorded_trajectory
from magical.demos.trajectory import Actor, Trajectory
from magical.envs.env import MagicalEnv
from magical.envs.ids import EnvId
from magical.scene import State

RECORDER = "magical play"  # in the metadata of episodes


class PlayedEpisode:
    """An episode from its reset to its last step, with all poses and velocities."""

    def __init__(self, env_id: EnvId, seed: int) -> None:
        self.env_id = env_id
        self.seed = seed
        self.env = MagicalEnv(env_id.task, env_id.variant, observation="state")
        self.env.reset(seed=seed)
        self.bodies: list[NDArray[np.float64]] = []
        self.last_action: int | None = None
        self.actors: list[Actor] = []  # who chose each action
        self.policy_actions: list[int] = []  # chosen by the watched policy, if any
        self._note_bodies()

    def step(self, action: int, actor: Actor, chosen: int | None = None) -> bool:
        """Step the environment; returns whether that was the last step.

        Args:
            action: the action to execute.
            actor: who chose it.
            chosen: the watched policy's choice, if there is such a policy.
        """
        self.actors.append(actor)
        if chosen is not None:
            self.policy_actions.append(chosen)
        self.last_action = action
        truncated = self.env.step(action)[3]
        self._note_bodies()
        return truncated

    def _note_bodies(self) -> None:
        self.bodies.append(self.env.state().bodies)

    @property
    def seen(self) -> tuple[State, int | None]:
        """The current state, and the action that led to it; `None` in the first state."""
        return self.env.state(), self.last_action

    @property
    def steps(self) -> int:
        """Control steps so far."""
        return len(self.bodies) - 1

    def trajectory(self, demonstrator: str, view: str, policy: str | None = None) -> Trajectory:
        """The episode as a demonstration.

        Args:
            demonstrator: the player's name.
            view: the view that the player saw last.
            policy: the name of the watched policy, if there was one.
        """
        metadata = {"recorder": RECORDER, "view": view}
        trajectory = recorded_trajectory(
            self.env,
            self.bodies,
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
