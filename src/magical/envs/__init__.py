"""The Gymnasium environments, single and vectorised, and their ids."""

from magical.envs.ids import EnvId, all_env_ids, parse_env_id
from magical.envs.registration import register_all, register_envs

__all__ = ["EnvId", "all_env_ids", "parse_env_id", "register_all", "register_envs"]
