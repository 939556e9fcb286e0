"""What the configurations of PPO and of all algorithms with PPO as a part of them share.

The defaults are Table 4's; `QUICK` is what the `quick` presets change, the same for every task, and
`PUBLISHED_CODE` what the `published-code` presets of the algorithms with learned rewards change.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

from magical.errors import InvalidConfigError
from magical.learning.config import (
    CHECKPOINT_SECONDS,
    PUBLISHED_CODE_IMAGES,
    Config,
    ImitationConfig,
    option,
)
from magical.runs.sources import INTERACTION
from magical.tasks import Horizon, have_two_horizons, require_two_horizons

INITS = ("torch", "centred")
HORIZONS = ("appendix", "published")
REWARD_FLOOR = 1e-3  # docs/specification.md, section 10
ACTION_INPUTS = ("one-hot", "embedding")

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
}

# docs/specification.md, section 11; docs/presets.md.
PUBLISHED_CODE: Mapping[str, Any] = {
    **PUBLISHED_CODE_IMAGES,
    "action_input": "embedding",
    "entropy_bonus": 2.5e-5,
    "reward_std": 0.01,
    "reward_floor": 1e-5,  # the published floor, 1e-3, is of the running deviation / reward_std
    "horizon": "published",
}


@dataclass(frozen=True, kw_only=True)
class ReinforcementConfig(Config):
    """Settings of every algorithm that improves its policy by PPO."""

    compile: bool = option(False, "compile the policy network (torch.compile)")
    init: str = option("torch", "initialisation of an image policy", choices=INITS)
    total_steps: int = option(1_000_000, "environment steps in all")
    num_envs: int = option(32, "parallel environments, split evenly between the tasks")
    time_steps: int = option(8, "steps of each environment per update")
    horizon: str = option(
        "appendix",
        "of training episodes and evaluations; published: 240 steps for the Cluster tasks",
        choices=HORIZONS,
        added=True,
    )
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
    checkpoint_every: int = option(
        0, f"updates between checkpoints; 0: one every {CHECKPOINT_SECONDS} s"
    )
    evaluate_every: int = option(200, "updates between evaluations; 0: never")
    evaluation_rollouts: int = option(20, "rollouts of each task per evaluation")

    def __post_init__(self) -> None:
        super().__post_init__()
        self.require_positive("total_steps", "num_envs", "time_steps", "epochs", "minibatch_size")
        self.require_positive("learning_rate", "clip", "max_grad_norm")
        self.require_positive("evaluation_rollouts")
        self.require_fraction("discount", "gae_lambda")
        self.require_at_least_zero("entropy_bonus", "evaluate_every", "checkpoint_every", "workers")
        if self.num_envs < len(self.tasks):
            raise InvalidConfigError(
                f"num_envs: expected at least one for each of {len(self.tasks)} tasks, "
                f"found {self.num_envs}"
            )
        if self.horizon == "published":
            require_two_horizons(self.tasks)

    @classmethod
    def preset(cls, name: str, **fields: Any) -> Self:
        """As `Config.preset`; a preset's `published` horizon is for tasks that have one."""
        tasks = fields.get("tasks", ())
        one_horizon = not have_two_horizons((tasks,) if isinstance(tasks, str) else tasks)
        if cls.presets.get(name, {}).get("horizon") == "published" and one_horizon:
            fields = {"horizon": "appendix", **fields}
        return super().preset(name, **fields)

    @property
    def env_horizon(self) -> Horizon:
        """The horizon as environments take it."""
        return "published" if self.horizon == "published" else None

    @property
    def learned_from(self) -> tuple[str, ...]:
        """See `Config`."""
        return (*super().learned_from, INTERACTION)

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


@dataclass(frozen=True, kw_only=True)
class LearnedRewardConfig(ReinforcementConfig, ImitationConfig):
    """Settings of the algorithms that learn a reward from demonstrations."""

    action_input: str = option(
        "one-hot",
        "how the network that gives the rewards takes actions: joined to the convolutions' output, "
        "or as a learnt embedding, joined before the last linear layer",
        choices=ACTION_INPUTS,
        added=True,
    )
    reward_std: float = option(0.1, "standard deviation of the normalised rewards")
    reward_floor: float = option(
        REWARD_FLOOR, "smallest standard deviation that rewards are divided by", added=True
    )
    replay_batches: int = option(4, "rollouts in the replay buffer of novice samples")

    def __post_init__(self) -> None:
        super().__post_init__()
        self.require_positive("reward_std", "reward_floor", "replay_batches")
