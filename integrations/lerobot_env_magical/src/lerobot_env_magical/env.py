"""The environment with LeRobot's keys."""

from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium import spaces

from lerobot_env_magical.observation import ROBOT_STATE, ViewsAndRobot
from magical.envs import EnvId, env_spec, parse_env_id
from magical.scene.constants import CONTROL_RATE

GYM_ID = "lerobot_env_magical/Magical-v0"


class LeRobotMagicalEnv(gymnasium.Env[dict[str, Any], Any]):
    """A task in a variant, with the keys of LeRobot's environments.

    Observations are `pixels` (`allo` and `ego`, uint8) and `agent_pos` (the robot's x, y and angle
    and the angles of its fingers, float32), as in a dataset of `lerobot_env_magical.export`.
    Actions are drive, turn and grip, each from -1 to 1 and clipped to that. The reward of an
    episode is its score, from 0 to 1, at the last step; `info["is_success"]` says whether that is
    above 0.5.

    Args:
        env_id: such as `MoveToCorner-Demo-v0`.
        size: of the images in pixels.
        render_mode: "rgb_array" or None.
    """

    metadata: ClassVar[dict[str, Any]] = {  # type: ignore[misc]
        "render_modes": ["rgb_array"],
        "render_fps": int(CONTROL_RATE),
    }

    def __init__(
        self,
        env_id: str,
        size: int = 96,
        render_mode: str | None = "rgb_array",
    ) -> None:
        parsed: EnvId = parse_env_id(env_id if "/" in env_id else f"magical/{env_id}")
        self.render_mode = render_mode
        made: Any = gymnasium.make(
            env_spec(parsed),
            observation=ViewsAndRobot(size),
            reward="score",
            render_mode=render_mode,
            action_space="continuous",
        )
        self._env = made.unwrapped
        self.task = f"{parsed.task}-{parsed.variant}"
        self.task_description = ""
        self._max_episode_steps = self._env.horizon
        self.action_space = self._env.action_space
        boxes = self._env.observation_space
        self.observation_space = spaces.Dict(
            {
                "pixels": spaces.Dict({k: v for k, v in boxes.items() if k != ROBOT_STATE}),
                ROBOT_STATE: boxes[ROBOT_STATE],
            }
        )

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Start an episode; `task_description` becomes its instruction."""
        observation, info = self._env.reset(seed=seed, options=options)
        self.task_description = info["instruction"]
        return _by_key(observation), info

    def step(self, action: Any) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Act for one control step; numbers beyond -1 and 1, which policies predict, are clipped.

        Raises:
            InvalidActionError: a number is not finite, or there are not three.
        """
        observation, *outcome = self._env.step(np.clip(action, -1, 1))
        return _by_key(observation), *outcome

    def render(self) -> Any:
        """Both views side by side."""
        return self._env.render()

    def close(self) -> None:
        """Close the environment."""
        self._env.close()


def _by_key(observation: dict[str, Any]) -> dict[str, Any]:
    """Both frames under LeRobot's key."""
    pixels = {name: frame for name, frame in observation.items() if name != ROBOT_STATE}
    return {"pixels": pixels, ROBOT_STATE: observation[ROBOT_STATE]}
