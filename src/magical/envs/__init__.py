"""The Gymnasium environments, single and vectorised, and their ids."""

from magical.envs.ids import (
    EnvId,
    all_env_ids,
    env_spec,
    parse_env_id,
    register_all,
    register_envs,
    register_published,
)

__all__ = [
    "EnvId",
    "all_env_ids",
    "env_spec",
    "parse_env_id",
    "register_all",
    "register_envs",
    "register_published",
]
