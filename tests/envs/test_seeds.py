"""Episodes to learn from never share a seed with episodes to be evaluated on."""

import numpy as np

from magical.envs.seeds import (
    FIRST_EVALUATION_SEED,
    episode_seed,
    evaluation_seed,
    sample_training_seeds,
)


def test_demonstrations_and_training_stay_below_evaluation() -> None:
    demos = {episode_seed(seed, episode) for seed in range(20) for episode in range(200)}
    assert len(demos) == 4000
    training = sample_training_seeds(np.random.default_rng(0), 4000)
    assert min(demos) >= 0
    assert max(demos | set(training)) < FIRST_EVALUATION_SEED <= evaluation_seed(0)
    assert max(demos) > 0.99 * FIRST_EVALUATION_SEED
