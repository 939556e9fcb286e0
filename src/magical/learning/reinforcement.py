"""What the configurations of PPO and of all algorithms with PPO as a part of them share.

The defaults are Table 4's; `QUICK` is what the `quick` presets change, the same for every task.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from magical.errors import InvalidConfigError
from magical.learning.config import PRECISIONS, Config, option

INITS = ("torch", "centred")

QUICK: Mapping[str, Any] = {
    "network": "light",
    "init": "centred",
    "precision": "auto",
    "total_steps": 100_000,
    "time_steps": 16,
    "epochs": 4,
    "minibatch_size": 64,
    "learning_rate": 5e-4,
    "clip": 0.2,
    "discount": 0.9,
    "gae_lambda": 0.8,
    "entropy_bonus": 1e-3,
    "normalise_advantages": True,
    "bootstrap": True,
    "evaluate_every": 50,
    "checkpoint_every": 25,
}


@dataclass(frozen=True, kw_only=True)
class ReinforcementConfig(Config):
    """Settings of every algorithm that improves its policy by PPO."""

    # Ratios are compared with a clip range of 0.01: bfloat16's resolution is nearly as coarse.
    precision: str = option(
        "float32", "of the forward and backward pass; auto: by the processor", choices=PRECISIONS
    )
    compile: bool = option(False, "compile the policy network (torch.compile)")
    init: str = option("torch", "initialisation of an image policy", choices=INITS)
    total_steps: int = option(1_000_000, "environment steps in all")
    num_envs: int = option(32, "parallel environments, split evenly between the tasks")
    time_steps: int = option(8, "steps of each environment per update")
    decorrelate: bool = option(True, "start environments at different times of an episode")
    epochs: int = option(12, "passes over the samples per update")
    minibatch_size: int = option(64, "samples per step of the optimiser")
    learning_rate: float = option(6e-5, "Adam's initial learning rate")
    clip: float = option(0.01, "initial clip range of the probability ratio")
    anneal: bool = option(True, "anneal learning rate and clip range linearly to 0")
    discount: float = option(0.8, "gamma")
    gae_lambda: float = option(0.8, "lambda of generalised advantage estimation")
    entropy_bonus: float = option(1e-5, "weight of the policy's entropy")
    max_grad_norm: float = option(1.0, "gradients are clipped to this L2 norm")
    normalise_advantages: bool = option(False, "to mean 0 and standard deviation 1 per update")
    bootstrap: bool = option(False, "bootstrap the value at the time limit instead of using 0")
    workers: int | None = option(None, "environment processes (default: one per core)")
    checkpoint_every: int = option(50, "updates between checkpoints")
    evaluate_every: int = option(200, "updates between evaluations; 0: never")
    evaluation_rollouts: int = option(20, "rollouts of each task per evaluation")

    def __post_init__(self) -> None:
        super().__post_init__()
        self.require_positive("total_steps", "num_envs", "time_steps", "epochs", "minibatch_size")
        self.require_positive("learning_rate", "clip", "max_grad_norm", "checkpoint_every")
        self.require_positive("evaluation_rollouts")
        self.require_fraction("discount", "gae_lambda")
        self.require_at_least_zero("entropy_bonus", "evaluate_every", "workers")
        if self.num_envs < len(self.tasks):
            raise InvalidConfigError(
                f"num_envs: expected at least one for each of {len(self.tasks)} tasks, "
                f"found {self.num_envs}"
            )

    @property
    def steps_per_update(self) -> int:
        """Environment steps per update of the policy."""
        return self.num_envs * self.time_steps

    @property
    def updates(self) -> int:
        """Updates of the policy in a whole run."""
        return max(1, self.total_steps // self.steps_per_update)

    @property
    def total(self) -> int:
        """All updates."""
        return self.updates

    @property
    def training_samples(self) -> int:
        """Every step of an environment, once in each epoch."""
        return self.updates * self.steps_per_update * self.epochs
