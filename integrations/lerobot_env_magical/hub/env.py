"""MAGICAL for LeRobot's environment hub: this file is a repository's `env.py`.

It needs the distribution in `integrations/lerobot_env_magical`. LeRobot calls `make_env`.
"""

from functools import partial
from typing import Any

import gymnasium
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv
from lerobot_env_magical.env import LeRobotMagicalEnv

from magical.evaluation import environments

TASK = "MoveToCorner"


def make_env(
    n_envs: int = 1, use_async_envs: bool = False, cfg: Any = None
) -> dict[str, dict[int, gymnasium.vector.VectorEnv[Any, Any, Any]]]:
    """Vector environments of a task in each of its variants, which are the suites.

    Args:
        n_envs: sub-environments of each.
        use_async_envs: whether they are in processes of their own.
        cfg: LeRobot's configuration; its `task` is the task's name, by default `TASK`.
    """
    kind: Any = AsyncVectorEnv if use_async_envs else SyncVectorEnv
    made = {}
    for env_id in environments([getattr(cfg, "task", None) or TASK]):
        makers = [partial(LeRobotMagicalEnv, str(env_id)) for _ in range(n_envs)]
        made[env_id.variant] = {0: kind(makers, autoreset_mode=AutoresetMode.SAME_STEP)}
    return made
