"""MAGICAL's environments for LeRobot: `--env.type=magical`. Importing this registers them."""

import gymnasium

from lerobot_env_magical.config import MagicalEnvConfig
from lerobot_env_magical.env import GYM_ID, LeRobotMagicalEnv

# LeRobot reads `task_description` of the environment itself, which wrappers would hide.
gymnasium.register(
    GYM_ID,
    entry_point="lerobot_env_magical.env:LeRobotMagicalEnv",
    order_enforce=False,
    disable_env_checker=True,
)

__all__ = ["GYM_ID", "LeRobotMagicalEnv", "MagicalEnvConfig"]
