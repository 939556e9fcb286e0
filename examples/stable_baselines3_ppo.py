"""Reinforcement learning with Stable-Baselines3, then the benchmark's evaluation.

    pip install . ./goals stable-baselines3

PPO is trained on MoveToRegion with state vectors and the dense reward, then evaluated on every
variant.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env

from magical.evaluation import environments, evaluate, summarise

NUM_ENVS = 16
DEMO = "magical/MoveToRegion-Demo-v0"


class SB3Policy:
    """A Stable-Baselines3 model as a policy of the benchmark."""

    observation = "state"
    tasks = ("MoveToRegion",)

    def __init__(self, model: PPO) -> None:
        self.model = model

    def reset(self, mask: NDArray[np.bool_]) -> None:
        """Do nothing: the policy keeps no state between steps."""

    def act(
        self, observations: NDArray[np.float32], env_ids: Sequence[str], rng: np.random.Generator
    ) -> NDArray[np.int64]:
        """The most probable action for each state vector."""
        return np.asarray(self.model.predict(observations, deterministic=True)[0])


def main(steps: int = 50_000, rollouts: int = 100, workers: int | None = None) -> None:
    """Train on the Demo variant only, evaluate on all variants, print the scores."""
    envs = make_vec_env(DEMO, NUM_ENVS, env_kwargs={"observation": "state", "reward": "dense"})
    model = PPO(
        "MlpPolicy", envs, n_steps=80, batch_size=320, n_epochs=4, seed=0, device="cpu", verbose=1
    )
    model.learn(steps)
    envs.close()
    policy = SB3Policy(model)
    scores = evaluate(policy, environments(policy.tasks), rollouts=rollouts, workers=workers)
    for variant, summary in summarise(scores).items():
        print(f"{variant:10} {summary['mean']:.2f}")


if __name__ == "__main__":
    main()
