"""Vector environments of state vectors, as most of these tests need them."""

from typing import Any

from magical.envs.vector import MagicalVectorEnv

MIXED = (
    "magical/FindDupe-TestAll-v0",
    "magical/FindDupe-Demo-v0",
    "magical/FindDupe-TestDynamics-v0",
)
IDS = ("magical/MakeLine-Demo-v0", "magical/MakeLine-TestColour-v0")


def vector(
    env_ids: Any = MIXED, workers: int = 0, observation: Any = "state", **options: Any
) -> MagicalVectorEnv:
    return MagicalVectorEnv(env_ids, workers=workers, observation=observation, **options)


def started(env_ids: Any = IDS * 2, workers: int = 2, **options: Any) -> MagicalVectorEnv:
    """A vector environment that has been reset."""
    envs = vector(env_ids, workers, **options)
    envs.reset(seed=0)
    return envs
