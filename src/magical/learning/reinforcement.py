"""What the configurations of all reinforcement learners share: worlds, PPO, reports.

The defaults are Table 4's; `QUICK` is what the `quick` presets change, the same for every task.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from magical.errors import InvalidConfigError
from magical.learning.config import Config, option

QUICK: Mapping[str, Any] = {
    "network": "light",
    "first_weights": "centred",
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
    """Settings of every learner whose policy is improved by PPO."""

    # Ratios are compared with a clip range of 0.01: bfloat16's steps are nearly as large.
    precision: str = option("float32", "precision: auto (the faster one), float32 or bfloat16")
    compile: bool = option(False, "compile the policy's network (torch.compile)")
    first_weights: str = option("torch", "of a policy that sees images: torch or centred")
    total_steps: int = option(1_000_000, "environment steps in all")
    num_envs: int = option(32, "worlds side by side, split evenly between the tasks")
    time_steps: int = option(8, "steps of each world in an update")
    decorrelate: bool = option(True, "let worlds begin at different moments of an episode")
    epochs: int = option(12, "passes over the samples in an update")
    minibatch_size: int = option(64, "samples in a step of the optimiser")
    learning_rate: float = option(6e-5, "Adam's step size at the start")
    clip: float = option(0.01, "clip range of the probability ratio at the start")
    anneal: bool = option(True, "let step size and clip range fall linearly to 0")
    discount: float = option(0.8, "gamma")
    gae_lambda: float = option(0.8, "lambda of generalised advantage estimation")
    entropy_bonus: float = option(1e-5, "weight of the policy's entropy")
    max_grad_norm: float = option(1.0, "largest L2 norm of a gradient")
    normalise_advantages: bool = option(False, "mean 0 and standard deviation 1 in each update")
    bootstrap: bool = option(False, "value what would follow the time limit, in place of 0")
    workers: int | None = option(None, "processes for the worlds (default: one a core)")
    checkpoint_every: int = option(50, "updates between checkpoints")
    evaluate_every: int = option(200, "updates between evaluations; 0: never")
    evaluation_rollouts: int = option(20, "rollouts of each task in such an evaluation")

    def __post_init__(self) -> None:
        super().__post_init__()
        self.require_positive("total_steps", "num_envs", "time_steps", "epochs", "minibatch_size")
        self.require_positive("learning_rate", "clip", "max_grad_norm", "checkpoint_every")
        self.require_positive("evaluation_rollouts")
        self.require_one_of("first_weights", ("torch", "centred"))
        for name in ("discount", "gae_lambda"):
            if not 0 <= getattr(self, name) <= 1:
                raise InvalidConfigError(
                    f"{name}: expected a number from 0 to 1, found {getattr(self, name)}"
                )
        for name in ("entropy_bonus", "evaluate_every", "workers"):
            if (getattr(self, name) or 0) < 0:
                raise InvalidConfigError(
                    f"{name}: expected at least 0, found {getattr(self, name)}"
                )
        if self.num_envs < len(self.tasks):
            raise InvalidConfigError(
                f"num_envs: expected at least one for each of {len(self.tasks)} tasks, "
                f"found {self.num_envs}"
            )

    @property
    def steps_per_update(self) -> int:
        """Environment steps between two improvements of the policy."""
        return self.num_envs * self.time_steps

    @property
    def updates(self) -> int:
        """Improvements of the policy in a whole run."""
        return max(1, self.total_steps // self.steps_per_update)

    @property
    def total(self) -> int:
        """All updates."""
        return self.updates

    def require_one_task(self) -> None:
        """Raise `InvalidConfigError` for several tasks."""
        if len(self.tasks) > 1:
            raise InvalidConfigError(
                f"{self.algorithm}: expected one task (it is not defined for several), found "
                f"{', '.join(self.tasks)}; use gail, or a run for each task"
            )
