"""Proximal policy optimisation (Schulman et al., 2017) with the settings of appendix B, Table 4.

One update:

1. collect a rollout: T steps of N environments with actions from the current policy;
2. estimate the advantages A by generalised advantage estimation (GAE);
3. for some epochs over shuffled minibatches, minimise the clipped surrogate loss with Adam.

`train` uses the environment's reward; other algorithms pass learned ones to `improve_policy`.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, NamedTuple, Self

import numpy as np
import torch
from torch import Tensor

from magical.envs.env import REWARDS, Reward
from magical.errors import InvalidConfigError
from magical.observe import STATE
from magical.runs.sources import SCORE
from magical.tasks import Horizon, have_two_horizons, require_two_horizons
from magical_baselines.augmentation.augment import to_unit
from magical_baselines.compute import ReplayedStep
from magical_baselines.config import (
    IMAGE_OBSERVATIONS,
    Algorithm,
    Fraction,
    NonNegativeFloat,
    PositiveFloat,
    PositiveInt,
    option,
)
from magical_baselines.models import ActorCritic, Trunk, centre, init_normal
from magical_baselines.rollouts import (
    InteractionConfig,
    InteractionTrainer,
    Metrics,
    RewardNormaliser,
    Rollout,
    collect_rollout,
    explained_variance,
    shuffle_evenly,
)
from magical_baselines.training import (
    Averages,
    Purpose,
    Run,
    anneal,
    gradient_step,
    seeded_init,
    stream,
)

OWN_NETWORKS = ("light", "narrow", "paper")  # whose steps do not wait for the device
VF_COEF = 0.5
ADVANTAGE_EPSILON = 1e-8

# What the preset `quick` changes, also in algorithms with learned rewards.
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

# The environment's rewards are sparser than a discriminator's and need a longer time scale.
SPARSE: Mapping[str, Any] = {"minibatch_size": 128, "gamma": 0.95, "gae_lambda": 0.95}

# What `published-code` changes where rewards are learned (docs/specification.md, section 11).
PUBLISHED_CODE: Mapping[str, Any] = {
    "conventions": "published",
    "ent_coef": 2.5e-5,
    "reward_std": 0.01,
    "horizon": "published",
}


@dataclass(frozen=True, kw_only=True)
class ReinforcementConfig(InteractionConfig):
    """Options of PPO and of all algorithms that contain PPO; the defaults are Table 4's."""

    init: Literal["torch", "centred"] = option(
        "torch", "initialisation of policies that observe images"
    )
    horizon: Literal["appendix", "published"] = option(
        "appendix", "horizon of all episodes; published: 240 steps for the Cluster tasks"
    )
    epochs: PositiveInt = option(12, "passes over the samples per update")
    minibatch_size: PositiveInt = option(64, "samples per optimiser step")
    learning_rate: PositiveFloat = option(6e-5, "Adam's initial learning rate")
    clip_range: PositiveFloat = option(0.01, "epsilon: initial clip range of probability ratios")
    anneal: bool = option(True, "anneal learning rate and clip range linearly to 0")
    gamma: Fraction = option(0.8, "discount factor")
    gae_lambda: Fraction = option(0.8, "lambda of generalised advantage estimation")
    ent_coef: NonNegativeFloat = option(1e-5, "weight of the policy's entropy")
    max_grad_norm: PositiveFloat = option(1.0, "gradients are clipped to this L2 norm")
    normalise_advantages: bool = option(
        False, "in each update, normalise advantages to mean 0 and standard deviation 1"
    )
    bootstrap: bool = option(False, "bootstrap the value at the time limit instead of using 0")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.horizon == "published":
            require_two_horizons(self.tasks)
        if self.normalise_advantages and self.steps_per_update < 2:
            raise InvalidConfigError(
                "normalise_advantages: expected at least 2 environment steps per update, found 1"
            )

    @property
    def env_horizon(self) -> Horizon:
        return "published" if self.horizon == "published" else None

    @classmethod
    def preset(cls, name: str, /, **settings: Any) -> Self:
        """As `Config.preset`, but without a preset's `published` horizon if no task has one."""
        if "horizon" in settings or cls.presets.get(name, {}).get("horizon") != "published":
            return super().preset(name, **settings)
        config = super().preset(name, **settings, horizon="appendix")
        two = have_two_horizons(config.tasks)
        return config.replace(horizon="published") if two else config


@dataclass(frozen=True, kw_only=True)
class PPOConfig(ReinforcementConfig):
    """Settings of proximal policy optimisation; the defaults are Table 4's."""

    observations: ClassVar[tuple[str, ...]] = (*IMAGE_OBSERVATIONS, STATE)
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "paper": {},
        "quick": {**QUICK, **SPARSE},
        # The dense reward, which magical-goals offers.
        "dense": {**QUICK, **SPARSE, "reward": "dense"},
        # State vectors and the dense reward, on whose time scale an episode is short.
        "states": {
            **QUICK,
            "reward": "dense",
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
        },
    }

    algorithm: str = "ppo"
    reward: str = option("score", "the environment's reward", plugins=REWARDS, known=("score",))

    @property
    def learned_from(self) -> tuple[str, ...]:
        return (*super().learned_from, SCORE)


def train(config: PPOConfig, run: Run) -> None:
    """Maximise the environment's reward."""
    with PPOTrainer(config, run, config.reward) as ppo:
        for update in ppo.remaining_updates():
            rollout = ppo.collect_rollout(update)
            metrics = ppo.improve_policy(update, rollout, rollout.rewards)
            if ppo.finish_update(update, metrics):
                break


def make_policy(config: ReinforcementConfig) -> ActorCritic:
    """The actor-critic of PPO-based algorithms, without batch norm, initialised from the seed."""
    with seeded_init(config.seed):
        trunk = Trunk(config.network, config.input_shape, pixel_range=config.pixel_range)
        network = ActorCritic(trunk, len(config.tasks))
        if config.init == "centred" and trunk.convolutions is not None:
            centre(network)
        if config.published:
            init_normal(network.policy, network.value)
        return network


class PPOTrainer(InteractionTrainer):
    """An actor-critic, its optimiser and its environments."""

    config: ReinforcementConfig
    network: ActorCritic

    def __init__(self, config: ReinforcementConfig, run: Run, reward: Reward = "none") -> None:
        super().__init__(config, run, make_policy(config), config.learning_rate, reward)
        # A plug-in's network may wait for the device, which cannot be recorded.
        own = config.network in OWN_NETWORKS
        self._replayed = ReplayedStep(self.optimizer, own and self.device == "cuda")

    def forward(
        self, observations: Tensor, tasks: Tensor, in_range: bool = False
    ) -> tuple[Tensor, Tensor]:
        """Logits (B, 18) and values (B,), float32, of inputs (B, ...); `in_range`: see `Trunk`."""
        with self.compute.autocast():
            logits, values = self.network.logits_and_values(observations, tasks, in_range=in_range)
        return logits.float(), values.float()

    def collect_rollout(self, update: int) -> Rollout:
        """Step all environments T times with actions sampled from the current policy."""
        config, rng = self.config, stream(self.config.seed, Purpose.ACTIONS, update)
        with self.monitor.timed("sample"):
            rollout = collect_rollout(
                self.envs, self.forward, config.num_steps, config.bootstrap, rng
            )
        self.monitor.add_rollout(rollout.actions, rollout.scores)
        return rollout

    def improve_policy(
        self,
        update: int,
        rollout: Rollout,
        rewards: Tensor,
        normaliser: RewardNormaliser | None = None,
    ) -> Metrics:
        """Train on a rollout with rewards (T, N) for `epochs` passes of minibatch steps.

        Learned rewards are normalised first.
        """
        config, averages, metrics = self.config, Averages(), Metrics()
        if normaliser:
            metrics["raw_reward"] = rewards.mean().item()
            metrics["raw_reward_std"] = rewards.std(correction=0).item()
            rewards = normaliser(rewards, rollout.tasks)
        with self.monitor.timed("policy"):
            advantages = compute_gae(rollout, rewards, config.gamma, config.gae_lambda)
            returns = advantages + rollout.values
            if config.normalise_advantages:
                spread = advantages.std() + ADVANTAGE_EPSILON
                advantages = (advantages - advantages.mean()) / spread
            # Scaled and converted once instead of in every epoch.
            observations = self.network.trunk.to_range(to_unit(rollout.observations.flatten(0, 1)))
            samples = Samples(
                self.compute.cast(observations),
                rollout.actions.flatten(),
                rollout.log_probs.flatten(),
                advantages.flatten(),
                returns.flatten(),
                rollout.tasks.repeat(config.num_steps),
            )
            updates = config.policy_updates
            left = anneal(self.optimizer, update, updates) if config.anneal else 1.0
            clip_range = torch.tensor(config.clip_range * left, device=self.device)
            rng = stream(config.seed, Purpose.MINIBATCHES, update)
            tasks = np.tile(self.envs.task_of, config.num_steps)  # (T * N,)
            for _ in range(config.epochs):
                order = torch.from_numpy(shuffle_evenly(tasks, rng)).to(self.device)
                for rows in torch.split(order, config.minibatch_size):
                    minibatch = (part[rows] for part in samples)
                    averages.add(len(rows), **self._replayed(self._step, clip_range, *minibatch))
        return {
            **metrics,
            "reward": rewards.mean().item(),
            "reward_std": rewards.std(correction=0).item(),
            **averages.reset(),
            "explained_variance": explained_variance(rollout.values.flatten(), samples.returns),
        }

    def _step(self, clip_range: Tensor, *samples: Tensor) -> dict[str, Tensor]:
        """Take one optimiser step on a minibatch of `Samples`; returns the parts of the loss."""
        minibatch = Samples(*samples)
        logits, values = self.forward(minibatch.observations, minibatch.tasks, in_range=True)
        loss, parts = ppo_loss(logits, values, minibatch, clip_range, self.config.ent_coef)
        gradient_step(self.optimizer, loss, self.config.max_grad_norm)
        return parts


class Samples(NamedTuple):
    """The B = T * N samples of a rollout, or a minibatch of them."""

    observations: Tensor  # (B, ...) network inputs
    actions: Tensor  # (B,) int64
    log_probs: Tensor  # (B,), of the actions under the policy that collected them
    advantages: Tensor  # (B,)
    returns: Tensor  # (B,), the value targets
    tasks: Tensor  # (B,) int64


def compute_gae(rollout: Rollout, rewards: Tensor, gamma: float, gae_lambda: float) -> Tensor:
    """Generalised advantage estimates (T, N) for rewards (T, N).

    A_t = delta_t + gamma * lambda * (1 - done_t) * A_{t+1}, where
    delta_t = r_t + gamma * V(s_{t+1}) - V(s_t). At the end of an episode, V(s_{t+1}) is 0 or the
    value of the final observation; `Rollout.next_values` already contains the right one.
    """
    deltas = rewards + gamma * rollout.next_values - rollout.values
    weights = gamma * gae_lambda * ~rollout.dones
    advantages = torch.empty_like(deltas)
    following = torch.zeros_like(deltas[0])
    for t in reversed(range(len(deltas))):
        following = deltas[t] + weights[t] * following
        advantages[t] = following
    return advantages


def ppo_loss(
    logits: Tensor, values: Tensor, minibatch: Samples, clip_range: Tensor, ent_coef: float
) -> tuple[Tensor, dict[str, Tensor]]:
    """The loss to be minimised, and its parts.

    With epsilon = `clip_range` and ratio = pi(a | s) / pi_old(a | s),

        policy loss = -mean(min(ratio * A, clip(ratio, 1 - epsilon, 1 + epsilon) * A))
        value loss = 0.5 * mean((V(s) - return)^2)
        loss = policy loss + value loss - ent_coef * entropy

    for logits (B, 18) of the current policy pi and its values V (B,).
    """
    log_policy = logits.log_softmax(dim=1)  # (B, 18)
    log_probs = log_policy.gather(1, minibatch.actions[:, None]).squeeze(1)
    ratio = (log_probs - minibatch.log_probs).exp()
    clipped = ratio.clamp(1.0 - clip_range, 1.0 + clip_range)
    advantages = minibatch.advantages
    policy_loss = -torch.minimum(ratio * advantages, clipped * advantages).mean()
    value_loss = VF_COEF * (values - minibatch.returns).square().mean()
    entropy = -(log_policy.exp() * log_policy).sum(dim=1).mean()
    loss = policy_loss + value_loss - ent_coef * entropy
    clip_fraction = ((ratio - 1.0).abs() > clip_range).float().mean()
    return loss, {
        "policy_loss": policy_loss,
        "value_loss": value_loss,
        "entropy": entropy,
        "clip_fraction": clip_fraction,
    }


ALGORITHM = Algorithm(PPOConfig, train, make_policy)
