"""Proximal policy optimisation (Schulman et al., 2017) with the settings of appendix B, Table 4.

One update:

1. collect a rollout: T steps of N environments with actions from the present policy;
2. estimate the advantages A by generalised advantage estimation (GAE);
3. for some epochs over shuffled minibatches, minimise the clipped surrogate loss by Adam.

`train` uses the environment's reward; other algorithms pass learned ones to `improve_policy`.
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np
import torch
from torch import Tensor, nn

from magical.envs.env import Reward
from magical.learning.algorithms import Algorithm
from magical.learning.augmentation.augment import to_unit
from magical.learning.config import IMAGE_OBSERVATIONS, option
from magical.learning.models import make_actor_critic, sample_actions
from magical.learning.policy import DemoEvaluation
from magical.learning.reinforcement.config import QUICK, ReinforcementConfig
from magical.learning.reinforcement.monitoring import Metrics, Monitor, explained_variance
from magical.learning.reinforcement.rollouts import (
    Rollout,
    RolloutBuffer,
    RolloutEnvs,
    shuffle_evenly,
)
from magical.learning.running.checkpoints import (
    StateDict,
    load_module,
    load_optimizer,
    optimizer_state,
)
from magical.learning.running.devices import choose_device, one_thread
from magical.learning.running.graphs import GraphedStep, use_graphs
from magical.learning.running.optimizers import make_adam, set_learning_rate
from magical.learning.running.run import Run
from magical.learning.running.streams import Purpose, stream
from magical.observe import NAMED
from magical.runs.sources import SCORE

ADVANTAGE_EPSILON = 1e-8
Forward = Callable[[Tensor, Tensor], tuple[Tensor, Tensor]]  # as `PPOTrainer.forward`
LOSS_PARTS = ("policy_loss", "value_loss", "entropy", "clip_fraction")


@dataclass(frozen=True, kw_only=True)
class PPOConfig(ReinforcementConfig):
    """Settings of proximal policy optimisation; the defaults are Table 4's."""

    algorithm: ClassVar[str] = "ppo"
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "paper": {},
        # The environment's rewards are sparser than a discriminator's: a longer time scale.
        "quick": {**QUICK, "minibatch_size": 128, "discount": 0.95, "gae_lambda": 0.95},
    }

    observation: str = option(
        "LoRes4E", "observation preset", choices=(*IMAGE_OBSERVATIONS, *NAMED)
    )
    reward: str = option("dense", "the environment's reward", choices=("dense", "score"))

    @property
    def learned_from(self) -> tuple[str, ...]:
        """See `Config`."""
        return (*super().learned_from, SCORE)


def train(config: PPOConfig, run: Run) -> None:
    """Maximise the environment's reward."""
    with PPOTrainer(config, run, config.reward) as ppo:  # type: ignore[arg-type]
        for update in ppo.remaining_updates():
            rollout = ppo.collect_rollout(update)
            metrics = ppo.improve_policy(update, rollout, rollout.rewards)
            if ppo.finish_update(update, metrics):
                break


class PPOTrainer:
    """An actor-critic, its optimiser and its environments."""

    def __init__(
        self,
        config: ReinforcementConfig,
        run: Run,
        reward: Reward = "none",
        *,
        previous_steps: int = 0,
    ) -> None:
        """Create a new trainer, or resume from the run's checkpoint.

        `previous_steps` is what the run takes before the first update, such as pretraining.
        """
        self.config, self.run, self.previous_steps = config, run, previous_steps
        self.device = choose_device(config.device)
        self.network = make_actor_critic(config).to(self.device)
        self.optimizer = make_adam(self.network.parameters(), config.learning_rate)
        vectors = len(config.input_shape) == 1
        # Positions need more digits than pixels.
        precision = "float32" if vectors and config.precision == "auto" else config.precision
        self.compute = run.compute(self.device, precision, config.threads)
        forward = self.network.logits_and_values
        self._forward = torch.compile(forward) if config.compile else forward
        self._graphed_step = GraphedStep(self._step, use_graphs(config.graphs, self.device))
        self.monitor = Monitor()
        with ExitStack() as stack:
            if vectors:
                stack.enter_context(one_thread())
            self.envs = stack.enter_context(RolloutEnvs(config, self.device, reward))
            self._demo_evaluation = stack.enter_context(
                DemoEvaluation(self.network, config, self.compute)
            )
            self._start_or_resume()
            self._stack = stack.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._stack.close()

    def remaining_updates(self) -> Iterator[int]:
        """The numbers of the updates that are not done yet."""
        yield from range(max(self.run.step - self.previous_steps, 0), self.config.updates)

    def forward(self, observations: Tensor, tasks: Tensor) -> tuple[Tensor, Tensor]:
        """Logits (B, 18) and values (B,), float32, of network inputs (B, ...)."""
        with self.compute.autocast():
            logits, values = self._forward(observations, tasks)
        return logits.float(), values.float()

    def collect_rollout(self, update: int) -> Rollout:
        """Step all environments T times with actions sampled from the present policy."""
        rng = stream(self.config.seed, Purpose.ACTIONS, update)
        with self.monitor.timed("sample"):
            rollout = collect_rollout(self.envs, self.forward, self.config, rng)
        self.monitor.add_rollout(rollout)
        return rollout

    def improve_policy(self, update: int, rollout: Rollout, rewards: Tensor) -> Metrics:
        """Take `epochs` passes of minibatch steps on a rollout with rewards (T, N)."""
        with self.monitor.timed("policy"):
            config = self.config
            samples = make_samples(rollout, rewards, config)
            # Autocast would convert unit pixels in every epoch; others are converted when mapped.
            if self.compute.precision == "bfloat16" and config.pixel_range == "unit":
                samples = samples._replace(observations=samples.observations.bfloat16())
            left = 1.0 - update / config.updates if config.anneal else 1.0
            set_learning_rate(self.optimizer, config.learning_rate * left)
            clip = torch.tensor(config.clip * left, device=self.device)
            rng = stream(config.seed, Purpose.MINIBATCHES, update)
            tasks = np.tile(self.envs.task_of, config.time_steps)  # (T * N,)
            sums = torch.zeros(len(LOSS_PARTS), device=self.device)
            for _ in range(config.epochs):
                order = torch.from_numpy(shuffle_evenly(tasks, rng)).to(self.device)
                for rows in torch.split(order, config.minibatch_size):
                    (parts,) = self._graphed_step(*samples, rows, clip)
                    sums += parts * len(rows)
            means = (sums / (config.epochs * len(tasks))).tolist()
        return {
            "reward": rewards.mean().item(),
            "reward_std": rewards.std(correction=0).item(),
            **dict(zip(LOSS_PARTS, means, strict=True)),
            "explained_variance": explained_variance(rollout.values.flatten(), samples.returns),
        }

    def _step(self, *inputs: Tensor) -> tuple[Tensor]:
        """Take one step of the optimiser on a minibatch; returns the loss's parts.

        The inputs are all samples, the rows of the minibatch (B,), and the clip range.
        """
        *samples, rows, clip = inputs
        minibatch = Samples(*samples).select(rows)
        logits, values = self.forward(minibatch.observations, minibatch.tasks)
        loss, parts = ppo_loss(logits, values, minibatch, clip, self.config.entropy_bonus)
        self.optimizer.zero_grad()
        torch.autograd.backward(loss)
        nn.utils.clip_grad_norm_(self.network.parameters(), self.config.max_grad_norm)
        self.optimizer.step()
        return (parts,)

    def finish_update(
        self, update: int, metrics: Metrics, extra_state: Callable[[], StateDict] = dict
    ) -> bool:
        """Log, evaluate and save checkpoints (with the extra state); true if the run stops."""
        config, done = self.config, update + 1
        step = self.previous_steps + done
        stops = done == config.updates or self.run.stops(step)
        metrics |= self.monitor.metrics()
        every = config.evaluate_every
        if every and (done % every == 0 or done == config.updates):
            metrics["evaluation_score"] = self._demo_evaluation.score()
        steps: Metrics = {"environment_steps": done * config.steps_per_update}
        self.run.log(step, config.total, **self.monitor.warning(metrics), **steps, **metrics)
        self.run.require_finite(step, metrics)
        if stops or self.run.checkpoint_is_due(done, config.checkpoint_every):
            self.run.checkpoint(step, {**self.state_dict(), **extra_state()})
        return stops

    def state_dict(self) -> StateDict:
        """Everything that the next update depends on."""
        ppo = {
            "optimizer": optimizer_state(self.optimizer),
            "envs": self.envs.state_dict(),
            "monitor": self.monitor.state_dict(),
        }
        return {"policy": self.network.state_dict(), "ppo": ppo}

    def _start_or_resume(self) -> None:
        saved = self.run.saved or {}
        if "ppo" not in saved:
            self.envs.reset()
            return
        load_module(self.network, saved["policy"], str(self.run.folder))
        load_optimizer(self.optimizer, saved["ppo"]["optimizer"])
        self.envs.load_state_dict(saved["ppo"]["envs"])
        self.monitor.load_state_dict(saved["ppo"]["monitor"])


def collect_rollout(
    envs: RolloutEnvs, forward: Forward, config: ReinforcementConfig, rng: np.random.Generator
) -> Rollout:
    """Step the environments T times with actions sampled from the logits of `forward`."""
    buffer = RolloutBuffer(config.time_steps, envs)
    uniforms = torch.from_numpy(rng.random(buffer.shape, np.float32)).to(envs.device)  # (T, N)
    with torch.no_grad():
        for t in range(config.time_steps):
            observations = buffer.add_observations(t, envs.observations())
            logits, values = forward(to_unit(observations), envs.tasks)
            actions, log_probs = sample_actions(logits, uniforms[t])
            step = envs.step(actions)
            buffer.add(t, actions, log_probs, values, step)
            if config.bootstrap and step.final_observations is not None:
                rows = torch.from_numpy(np.flatnonzero(step.dones)).to(envs.device)
                final = to_unit(step.final_observations.to(envs.device))
                buffer.final_values[t, rows] = forward(final, envs.tasks[rows])[1]
        _, next_values = forward(to_unit(envs.observations().to(envs.device)), envs.tasks)
    return buffer.rollout(next_values)


class Samples(NamedTuple):
    """The samples of a rollout, B = T * N, or a minibatch of them."""

    observations: Tensor  # (B, ...) network inputs
    actions: Tensor  # (B,) int64
    log_probs: Tensor  # (B,), of the actions under the policy that collected them
    advantages: Tensor  # (B,)
    returns: Tensor  # (B,), the value targets
    tasks: Tensor  # (B,) int64

    def select(self, rows: Tensor) -> "Samples":
        """A minibatch."""
        return Samples(*(part[rows] for part in self))


def make_samples(rollout: Rollout, rewards: Tensor, config: ReinforcementConfig) -> Samples:
    """Flatten a rollout, time-major, with the advantages and value targets of rewards (T, N)."""
    advantages = compute_gae(rollout, rewards, config.discount, config.gae_lambda)
    returns = advantages + rollout.values
    if config.normalise_advantages:
        advantages = (advantages - advantages.mean()) / (advantages.std() + ADVANTAGE_EPSILON)
    return Samples(
        to_unit(rollout.observations.flatten(0, 1)),
        rollout.actions.flatten(),
        rollout.log_probs.flatten(),
        advantages.flatten(),
        returns.flatten(),
        rollout.tasks.repeat(len(rewards)),
    )


def compute_gae(rollout: Rollout, rewards: Tensor, discount: float, gae_lambda: float) -> Tensor:
    """Generalised advantage estimates (T, N) for rewards (T, N).

    A_t = delta_t + discount * gae_lambda * (1 - done_t) * A_{t+1}, where
    delta_t = r_t + discount * V(s_{t+1}) - V(s_t). At the end of an episode V(s_{t+1}) is 0 or the
    value of the final observation: `Rollout.next_values` already contains the choice.
    """
    deltas = rewards + discount * rollout.next_values - rollout.values
    weights = discount * gae_lambda * ~rollout.dones
    advantages = torch.empty_like(deltas)
    following = torch.zeros_like(deltas[0])
    for t in reversed(range(len(deltas))):
        following = deltas[t] + weights[t] * following
        advantages[t] = following
    return advantages


def ppo_loss(
    logits: Tensor, values: Tensor, minibatch: Samples, clip: Tensor, entropy_bonus: float
) -> tuple[Tensor, Tensor]:
    """The loss to be minimised, and its parts (4,) as in `LOSS_PARTS`.

    With ratio = pi(a | s) / pi_old(a | s),

        policy loss = -mean(min(ratio * A, clip(ratio, 1 - clip, 1 + clip) * A))
        value loss = 0.5 * mean((V(s) - return)^2)
        loss = policy loss + value loss - entropy_bonus * entropy

    Args:
        logits: (B, 18) of the present policy pi.
        values: (B,) of the present value function V.
        minibatch: the samples.
        clip: (), the clip range.
        entropy_bonus: the weight of the entropy.
    """
    log_policy = logits.log_softmax(dim=1)  # (B, 18)
    log_probs = log_policy.gather(1, minibatch.actions[:, None]).squeeze(1)
    ratio = (log_probs - minibatch.log_probs).exp()
    clipped = ratio.clamp(1.0 - clip, 1.0 + clip)
    advantages = minibatch.advantages
    policy_loss = -torch.minimum(ratio * advantages, clipped * advantages).mean()
    value_loss = 0.5 * (values - minibatch.returns).square().mean()
    entropy = -(log_policy.exp() * log_policy).sum(dim=1).mean()
    loss = policy_loss + value_loss - entropy_bonus * entropy
    clip_fraction = ((ratio - 1.0).abs() > clip).float().mean()
    return loss, torch.stack([policy_loss, value_loss, entropy, clip_fraction]).detach()


ALGORITHM = Algorithm(PPOConfig, train, make_actor_critic)
