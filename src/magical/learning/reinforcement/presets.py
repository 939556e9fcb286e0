"""Changes to Table 4 by the presets of PPO and of the algorithms with learned rewards."""

from collections.abc import Mapping
from typing import Any

from magical.learning.config import PUBLISHED

# `quick`, for all of them.
QUICK: Mapping[str, Any] = {
    "network": "light",
    "init": "centred",
    "precision": "auto",
    "total_steps": 100_000,
    "num_steps": 16,
    "epochs": 4,
    "minibatch_size": 64,
    "learning_rate": 5e-4,
    "clip_range": 0.2,
    "gamma": 0.9,
    "gae_lambda": 0.8,
    "ent_coef": 1e-3,
    "normalise_advantages": True,
    "bootstrap": True,
    "evaluate_every": 50,
}

# `published-code`, for those with learned rewards (docs/specification.md, section 11).
PUBLISHED_CODE: Mapping[str, Any] = {
    "conventions": PUBLISHED,
    "ent_coef": 2.5e-5,
    "reward_std": 0.01,
    "horizon": PUBLISHED,
}

# `states`, for PPO: state vectors and the dense reward, on whose time scale an episode is short.
STATES: Mapping[str, Any] = {
    **QUICK,
    "observation": "state",
    "network": "paper",
    "total_steps": 1_500_000,
    "num_envs": 16,
    "num_steps": 128,
    "epochs": 8,
    "minibatch_size": 256,
    "learning_rate": 7e-4,
    "gamma": 0.99,
    "gae_lambda": 0.95,
    "ent_coef": 3e-3,
}
