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
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor

from magical.errors import InvalidConfigError
from magical_baselines.algorithms import Algorithm
from magical_baselines.augmentation.augment import augment, to_unit
from magical_baselines.augmentation.names import augment_option
from magical_baselines.config import DemonstrationSettings, NetworkSettings
from magical_baselines.data.expert_data import TaskTrajectories, load_demonstrations, split_evenly
from magical_baselines.models import PolicyNetwork, Trunk, centre, sample_actions
from magical_baselines.reinforcement.interaction import InteractionConfig, InteractionSettings
from magical_baselines.reinforcement.monitoring import Metrics
from magical_baselines.reinforcement.rollouts import EpisodeScores
from magical_baselines.reinforcement.trainer import InteractionTrainer
from magical_baselines.reinforcement.transitions import TransitionBuffer, Transitions
from magical_baselines.running.averages import Averages
from magical_baselines.running.checkpoints import StateDict, restoring
from magical_baselines.running.optimizers import set_learning_rate
from magical_baselines.running.run import Run
from magical_baselines.running.streams import Purpose, seeded_init, stream
from magical_baselines.settings import FRACTION, NOT_NEGATIVE, POSITIVE, option


@dataclass(frozen=True, kw_only=True)
class IQSettings(InteractionSettings):
    """How a soft Q function is learned; the defaults are the published code's for Pong."""

    num_steps: int = option(1, "T: steps of each environment per update", POSITIVE)
    buffer_size: int = option(50_000, "frames in the replay buffer, about one per step", POSITIVE)
    gradient_steps: int = option(32, "optimiser steps per update", POSITIVE)
    batch_size: int = option(
        128, "transitions per optimiser step, half of them from demonstrations", POSITIVE
    )
    learning_rate: float = option(1e-4, "Adam's initial learning rate", POSITIVE)
    anneal: bool = option(False, "anneal the learning rate linearly to 0")
    gamma: float = option(0.99, "discount factor", FRACTION)
    temperature: float = option(
        1e-3, "alpha: temperature of the soft value and of the policy", POSITIVE
    )
    chi2_scale: float = option(0.5, "beta: rewards are between -4 beta and 4 beta", POSITIVE)
    target_every: int = option(
        0,
        "optimiser steps between updates of the target network for V(s'); 0: no target network, "
        "and gradients pass through V(s')",
        NOT_NEGATIVE,
    )
    bootstrap: bool = option(True, "bootstrap the value at the time limit instead of using 0")
    augment: str = augment_option("none")


@dataclass(frozen=True, kw_only=True)
class IQLearnConfig(InteractionConfig):
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
    networks: NetworkSettings = field(default_factory=NetworkSettings)
    demonstrations: DemonstrationSettings
    iq: IQSettings = field(default_factory=IQSettings)

    def __post_init__(self) -> None:
        super().__post_init__()
        iq = self.iq
        self.require_halves("batch_size", iq.batch_size)
        # A step takes two frames if an episode ends; and there is a stack before them.
        least = iq.num_envs * (self.observation_spec.frames + 2)
        if iq.buffer_size < least:
            raise InvalidConfigError(
                f"buffer_size: expected at least {least} frames for {iq.num_envs} environments, "
                f"found {iq.buffer_size}"
            )

    @property
    def training_samples(self) -> int:
        """The transitions of all batches, and the passes on next observations.

        Those are forward passes only, a third of the cost, if there is a target network.
        """
        transitions = self.num_updates * self.iq.gradient_steps * self.iq.batch_size
        return transitions * 4 // 3 if self.iq.target_every else transitions * 2


def train(config: IQLearnConfig, run: Run) -> None:
    """Imitate demonstrations."""
    demonstrations = load_demonstrations(config, run)
    with IQTrainer(config, run, demonstrations) as iq:
        for update in range(run.step, config.num_updates):
            iq.collect(update)
            metrics = iq.improve(update)
            if iq.finish_update(update, metrics):
                break


def soft_value(q: Tensor, temperature: float) -> Tensor:
    """V = alpha log sum_a exp(Q(a) / alpha), (B,), for Q (B, 18)."""
    return temperature * (q / temperature).logsumexp(dim=1)


def iq_loss(
    q: Tensor, next_values: Tensor, batch: Transitions, settings: IQSettings
) -> tuple[Tensor, dict[str, Tensor]]:
    """The negative objective, to be minimised, and the values to log.

    Args:
        q: (2B, 18) for the observations; the first half is from the demonstrations.
        next_values: (2B,), V of the next observations.
        batch: the transitions.
        settings: gamma, alpha, beta, and whether to bootstrap.
    """
    temperature, half = settings.temperature, len(q) // 2
    following = next_values if settings.bootstrap else next_values * ~batch.ends
    future = settings.gamma * following
    values = soft_value(q, temperature)
    chosen = q.gather(1, batch.actions[:, None]).squeeze(1)  # Q(s, a)
    rewards = chosen - future
    chi2 = rewards.square().mean() / (4.0 * settings.chi2_scale)
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
    networks = config.networks
    with seeded_init(config.seed):
        trunk = Trunk(networks.network, config.input_shape, pixel_range=networks.pixel_range)
        network = QNetwork(trunk, len(config.tasks), config.iq.temperature)
        centre(network)
        return network


class IQTrainer(InteractionTrainer):
    """A soft Q function, its optimiser, its environments, and the transitions it learns from."""

    config: IQLearnConfig
    network: QNetwork

    def __init__(self, config: IQLearnConfig, run: Run, demonstrations: TaskTrajectories) -> None:
        """See `InteractionTrainer`."""
        super().__init__(config, run, make_policy(config), config.iq.learning_rate)
        self.target = deepcopy(self.network).requires_grad_(False)
        self.demonstrations = TransitionBuffer.of_demonstrations(
            demonstrations, config.tasks, config.observation_spec, self.device
        )
        self.replay_buffer = self.demonstrations.emptied(config.iq.buffer_size)
        self._augmentations = config.networks.augmentations(config.iq.augment)

    def collect(self, update: int) -> None:
        """Step all environments T times with actions sampled from the policy; fill the buffer."""
        envs, num_steps = self.envs, self.config.iq.num_steps
        rng = stream(self.config.seed, Purpose.ACTIONS, update)
        uniforms = torch.from_numpy(rng.random((num_steps, len(envs.tasks)), "f4"))
        taken, scores = [], EpisodeScores()
        with self.monitor.timed("sample"), torch.no_grad():
            for t in range(num_steps):
                observations = to_unit(envs.observations().to(envs.device))
                with self.compute.autocast():
                    logits = self.network(observations, envs.tasks)
                actions, _ = sample_actions(logits, uniforms[t].to(envs.device))
                _, dones, final, ended = envs.step(actions)
                self.replay_buffer.add(actions, dones, envs.observations(), final, envs.task_of)
                taken.append(actions)
                scores += ended
        self.monitor.add_rollout(torch.stack(taken), scores)

    def improve(self, update: int) -> Metrics:
        """Take an update's optimiser steps; returns the means of the logged values."""
        iq, averages = self.config.iq, Averages()
        left = 1.0 - update / iq.num_updates if iq.anneal else 1.0
        set_learning_rate(self.optimizer, iq.learning_rate * left)
        rng = stream(self.config.seed, Purpose.MINIBATCHES, update)
        with self.monitor.timed("policy"):
            for step in range(iq.gradient_steps):
                if iq.target_every and (update * iq.gradient_steps + step) % iq.target_every == 0:
                    self.target.load_state_dict(self.network.state_dict())
                counts = split_evenly(iq.batch_size // 2, len(self.config.tasks), rng)
                demonstrated = self.demonstrations.sample(counts, rng)
                batch = demonstrated.join(self.replay_buffer.sample(counts, rng))
                averages.add(1, **self._step(batch, rng))
        return {**averages.reset()}

    def _step(self, batch: Transitions, rng: np.random.Generator) -> dict[str, Tensor]:
        """Take one optimiser step on a batch; returns the values to log."""
        iq = self.config.iq
        network = self.target if iq.target_every else self.network
        observations = augment(batch.observations, self._augmentations, rng)
        following = augment(batch.next_observations, self._augmentations, rng)
        with self.compute.autocast():
            q = self.network.q(observations, batch.tasks)
            next_q = network.q(following, batch.tasks)
        loss, parts = iq_loss(q, soft_value(next_q, iq.temperature), batch, iq)
        self.optimizer.zero_grad()
        torch.autograd.backward(loss)
        self.optimizer.step()
        return parts

    def state_dict(self) -> StateDict:
        """See `InteractionTrainer`."""
        return {
            "policy": self.network.state_dict(),
            "target": self.target.state_dict(),
            "replay_buffer": self.replay_buffer.state_dict(),
            **super().state_dict(),
        }

    def start_or_resume(self) -> None:
        """See `InteractionTrainer`."""
        saved = self.run.saved
        if not saved:
            self.envs.reset()
            self.replay_buffer.start(self.envs.observations())
            return
        with restoring(self.run.folder):
            self.network.load_state_dict(saved["policy"])
            self.target.load_state_dict(saved["target"])
            self.replay_buffer.load_state_dict(saved["replay_buffer"])
            self.load_state_dict(saved)


ALGORITHM = Algorithm(IQLearnConfig, train, make_policy)
