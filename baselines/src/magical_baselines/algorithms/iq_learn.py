"""IQ-Learn: inverse soft Q-learning for imitation, with discrete actions.

Source: Garg, Chakraborty, Cundy, Song and Ermon, "IQ-Learn: inverse soft-Q learning for imitation",
NeurIPS 2021. There is neither a discriminator nor a reward function: a soft Q function defines

    V(s) = alpha log sum_a exp(Q(s, a) / alpha)          its soft value,
    pi(a | s) = exp((Q(s, a) - V(s)) / alpha)            its policy, and
    r(s, a) = Q(s, a) - gamma V(s')                      its reward.

With the chi-square divergence, Q maximises

    E_demo[r] - E_both[V(s) - gamma V(s')] - E_both[r^2] / (4 beta)

where `demo` are transitions of the demonstrations, and `both` are these and the policy's own, from
a replay buffer, in equal parts. The second term estimates the value of initial states. In the
paper's objective, the third is over the demonstrations only; over both, as in the published code's
commands for MuJoCo, it bounds the reward (Al-Hafez et al., "LS-IQ: implicit reward regularization
for inverse reinforcement learning", ICLR 2023). The published code calls alpha `init_temp` and beta
`alpha`.

One update:

1. collect a rollout: T steps of N environments with actions sampled from pi;
2. add it to the replay buffer;
3. take some optimiser steps on batches that are half demonstrated, half the policy's transitions.

In demonstrations and rollouts alike, every episode is truncated by its time limit and none
terminates. With `bootstrap`, as in the published code, the final observation is bootstrapped with
its V, as if the episode went on; without it, with 0.
"""

from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Tensor

from magical.errors import InvalidConfigError
from magical_baselines.augmentation.augment import augment
from magical_baselines.config import (
    Algorithm,
    DemonstrationConfig,
    Fraction,
    NonNegativeInt,
    PositiveFloat,
    PositiveInt,
    augment_option,
    option,
)
from magical_baselines.data import (
    ExpertData,
    ReplayBuffer,
    Transitions,
    expert_transitions,
    load_demonstrations,
    split_evenly,
)
from magical_baselines.models import PolicyNetwork, Trunk, centre, sample_actions
from magical_baselines.rollouts import EpisodeScores, InteractionConfig, InteractionTrainer
from magical_baselines.training import (
    Averages,
    Purpose,
    Run,
    anneal,
    gradient_step,
    seeded_init,
    stream,
)


@dataclass(frozen=True, kw_only=True)
class IQLearnConfig(DemonstrationConfig, InteractionConfig):
    """Settings of IQ-Learn; the defaults are the published code's for Pong."""

    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "paper": {},
        "quick": {
            "network": "narrow",
            "precision": "auto",
            "total_steps": 100_000,
            "num_steps": 16,
            "buffer_size": 20_000,
            "gradient_steps": 16,
            "batch_size": 64,
            "learning_rate": 5e-4,
            "anneal": True,
            "gamma": 0.9,
            "temperature": 0.1,
            "target_every": 100,
            "augment": "noise+translation+rotation",
            "evaluate_every": 25,
        },
    }

    algorithm: str = "iq-learn"
    num_steps: PositiveInt = option(1, "T: steps of each environment per update")
    buffer_size: PositiveInt = option(50_000, "frames in the replay buffer, about one per step")
    gradient_steps: PositiveInt = option(32, "optimiser steps per update")
    batch_size: PositiveInt = option(
        128, "transitions per optimiser step, half of them from demonstrations"
    )
    learning_rate: PositiveFloat = option(1e-4, "Adam's initial learning rate")
    anneal: bool = option(False, "anneal the learning rate linearly to 0")
    gamma: Fraction = option(0.99, "discount factor")
    temperature: PositiveFloat = option(
        1e-3, "alpha: temperature of the soft value and of the policy"
    )
    chi2_scale: PositiveFloat = option(0.5, "beta: rewards are between -4 beta and 4 beta")
    target_every: NonNegativeInt = option(
        0,
        "optimiser steps between updates of the target network for V(s'); 0: no target network, "
        "and gradients pass through V(s')",
    )
    bootstrap: bool = option(True, "bootstrap the value at the time limit instead of using 0")
    augment: str = augment_option("none")

    def __post_init__(self) -> None:
        super().__post_init__()
        self.require_halves("batch_size", self.batch_size)
        # A step takes two frames if an episode ends; and there is a stack before them.
        least = self.num_envs * (self.observation_spec.frames + 2)
        if self.buffer_size < least:
            raise InvalidConfigError(
                f"buffer_size: expected at least {least} frames for {self.num_envs} environments, "
                f"found {self.buffer_size}"
            )


def train(config: IQLearnConfig, run: Run) -> None:
    """Imitate demonstrations."""
    expert = ExpertData(
        load_demonstrations(config, run),
        config.tasks,
        config.observation_spec,
        device=run.compute.device,
        transitions=True,
    )
    network, augmentations = make_policy(config), config.augmentations(config.augment)
    with InteractionTrainer(config, run, network, config.learning_rate) as trainer:
        envs, optimizer, monitor = trainer.envs, trainer.optimizer, trainer.monitor
        target = deepcopy(network).requires_grad_(False)
        novice = ReplayBuffer(
            config.observation_spec, expert.frames, config.buffer_size, len(config.tasks)
        )
        if not run.keep(target=target, replay_buffer=novice):
            novice.start(envs.observations())
        for update in trainer.remaining_updates():
            # Collect transitions.
            rng = stream(config.seed, Purpose.ACTIONS, update)
            uniforms = torch.from_numpy(rng.random((config.num_steps, config.num_envs), "f4"))
            taken, scores = [], EpisodeScores()
            with monitor.timed("sample"), torch.no_grad():
                for t in range(config.num_steps):
                    with run.compute.autocast():
                        logits = network(envs.network_input(), envs.tasks)
                    actions, _ = sample_actions(logits, uniforms[t].to(envs.device))
                    _, dones, final, ended = envs.step(actions)
                    novice.add(actions, dones, envs.observations(), final, envs.task_of)
                    taken.append(actions)
                    scores += ended
            monitor.add_rollout(torch.stack(taken), scores)
            # Update the soft Q function.
            averages, every = Averages(), config.target_every
            if config.anneal:
                anneal(optimizer, update, config.num_updates)
            rng = stream(config.seed, Purpose.MINIBATCHES, update)
            with monitor.timed("policy"):
                for step in range(config.gradient_steps):
                    if every and (update * config.gradient_steps + step) % every == 0:
                        target.load_state_dict(network.state_dict())
                    counts = split_evenly(config.batch_size // 2, len(config.tasks), rng)
                    halves = expert_transitions(expert, counts, rng), novice.sample(counts, rng)
                    batch = Transitions(*map(torch.cat, zip(*halves, strict=True)))
                    before = augment(batch.observations, augmentations, rng)
                    after = augment(batch.next_observations, augmentations, rng)
                    with run.compute.autocast():
                        q = network.q(before, batch.tasks)
                        next_q = (target if every else network).q(after, batch.tasks)
                    next_values = soft_value(next_q, config.temperature)
                    loss, parts = iq_loss(q, next_values, batch, config)
                    gradient_step(optimizer, loss)
                    averages.add(1, **parts)
            if trainer.finish_update(update, {**averages.reset()}):
                break


def soft_value(q: Tensor, temperature: float) -> Tensor:
    """V = alpha log sum_a exp(Q(a) / alpha), (B,), for Q (B, 18)."""
    return temperature * (q / temperature).logsumexp(dim=1)


def iq_loss(
    q: Tensor, next_values: Tensor, batch: Transitions, config: IQLearnConfig
) -> tuple[Tensor, dict[str, Tensor]]:
    """The negative objective, to be minimised, and the values to log.

    Args:
        q: (2B, 18) for the observations; the first half is from the demonstrations.
        next_values: (2B,), V of the next observations.
        batch: the transitions.
        config: gamma, alpha, beta, and whether to bootstrap.
    """
    temperature, half = config.temperature, len(q) // 2
    following = next_values if config.bootstrap else next_values * ~batch.ends
    future = config.gamma * following
    values = soft_value(q, temperature)
    chosen = q.gather(1, batch.actions[:, None]).squeeze(1)  # Q(s, a)
    rewards = chosen - future
    chi2 = rewards.square().mean() / (4.0 * config.chi2_scale)
    loss = -rewards[:half].mean() + (values - future).mean() + chi2
    log_policy = (q / temperature).log_softmax(dim=1)
    return loss, {
        "loss": loss,
        "demo_reward": rewards[:half].mean(),
        "policy_reward": rewards[half:].mean(),
        "value": values.mean(),
        "demo_log_prob": (chosen - values)[:half].mean() / temperature,
        "entropy": -(log_policy.exp() * log_policy).sum(dim=1)[half:].mean(),
    }


class QNetwork(PolicyNetwork):
    """The soft Q function; called as a policy, it returns the logits Q / alpha."""

    def __init__(self, trunk: Trunk, num_tasks: int, temperature: float) -> None:
        super().__init__(trunk, num_tasks)
        self.temperature = temperature

    def q(self, observations: Tensor, tasks: Tensor) -> Tensor:
        """Q (B, 18), float32."""
        return super().forward(observations, tasks)

    def forward(self, observations: Tensor, tasks: Tensor) -> Tensor:
        """Logits (B, 18) of the policy."""
        return self.q(observations, tasks) / self.temperature


def make_policy(config: IQLearnConfig) -> QNetwork:
    """The soft Q function, without batch norm, initialised from the seed to be near 0."""
    with seeded_init(config.seed):
        trunk = Trunk(config.network, config.input_shape, pixel_range=config.pixel_range)
        network = QNetwork(trunk, len(config.tasks), config.temperature)
        centre(network)
        return network


ALGORITHM = Algorithm(IQLearnConfig, train, make_policy)
