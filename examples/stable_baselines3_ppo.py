"""Reinforcement learning with Stable-Baselines3, then the benchmark's evaluation.

    pip install ".[sb3]"

PPO is trained on MoveToRegion with state vectors and the dense reward, then evaluated on every
variant.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from stable_baselines3 import PPO

from magical.envs.sb3 import MagicalSB3VecEnv
from magical.envs.vector import MagicalVectorEnv
from magical.evaluation import environments, evaluate, summarise
from magical.progress import ProgressBar

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


def train(steps: int, workers: int | None = None) -> SB3Policy:
    """Train on the Demo variant only."""
    envs = MagicalVectorEnv(
        [DEMO] * NUM_ENVS,
        workers=workers,
        observation="state",
        reward="dense",
        autoreset_mode="SameStep",
    )
    model = PPO(
        "MlpPolicy",
        MagicalSB3VecEnv(envs),
        n_steps=80,
        batch_size=320,
        n_epochs=4,
        seed=0,
        device="cpu",
    )
    print(f"training for {steps:,} steps")
    with ProgressBar("steps", steps) as bar:

        def advance(*_: object) -> bool:
            bar.advance(NUM_ENVS)
            return True  # continue training

        model.learn(steps, callback=advance)
    envs.close()
    return SB3Policy(model)


def main(steps: int = 50_000, rollouts: int = 100, workers: int | None = None) -> None:
    """Train, evaluate on all variants, print the scores."""
    policy = train(steps, workers)
    env_ids = environments(policy.tasks)
    print(f"evaluating {rollouts} rollouts in each of {len(env_ids)} environments")
    with ProgressBar("rollouts", rollouts * len(env_ids)) as bar:
        scores = evaluate(policy, env_ids, rollouts=rollouts, workers=workers, progress=bar.advance)
    for variant, summary in summarise(scores).items():
        print(f"{variant:10} {summary['mean']:.2f}")


if __name__ == "__main__":
    main()
