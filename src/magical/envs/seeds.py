"""Episode seeds for evaluation, for demonstrations and for training.

Seeds from `FIRST_EVALUATION_SEED` upwards are reserved for evaluation (docs/protocol.md).
"""

import numpy as np

FIRST_EVALUATION_SEED = 1_000_000_000
EVALUATION_SET_SIZE = 1_000_000  # seeds in one set


def evaluation_seed(rollout: int, seed: int = 0) -> int:
    """The seed that rollout number `rollout` of every environment is reset with.

    It depends on nothing else, so every policy gets the same scenes. `seed` chooses another set.
    """
    return FIRST_EVALUATION_SEED + EVALUATION_SET_SIZE * seed + rollout


def episode_seed(seed: int, episode: int) -> int:
    """The seed of episode number `episode` in a series of demonstrations, below evaluation's."""
    return int(np.random.default_rng([seed, episode]).integers(FIRST_EVALUATION_SEED))


def sample_training_seeds(rng: np.random.Generator, count: int) -> list[int]:
    """Sample the seeds of `count` training episodes, below evaluation's range."""
    seeds: list[int] = rng.integers(FIRST_EVALUATION_SEED, size=count).tolist()
    return seeds
