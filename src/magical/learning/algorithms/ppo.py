"""Proximal policy optimisation on the vector environment (appendix B, Table 4).

Collect samples, value them, improve the policy, report; again. `train` learns from the
environment's own reward. The imitation learners use the same `Learner` with a reward of theirs.
"""

import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np
import torch
from torch import Tensor, nn
from torch.optim import Adam

from magical.envs import EnvId
from magical.evaluation import evaluate
from magical.learning.algorithms import Algorithm
from magical.learning.batches import Batch, as_batch, explained_variance, mean_by_task, spread
from magical.learning.checkpoints import Tree, load_module, load_optimizer, optimizer_tree
from magical.learning.collapse import Watch
from magical.learning.config import option
from magical.learning.curves import draw_curves
from magical.learning.devices import choose_device, one_thread
from magical.learning.networks import ActorCritic, StateTrunk, Trunk, centre, get_width
from magical.learning.policy import NetworkPolicy
from magical.learning.reinforcement import QUICK, ReinforcementConfig
from magical.learning.rollout import Sampler, Samples, as_inputs
from magical.learning.runs import METRICS, Run
from magical.learning.streams import Purpose, seeded_weights, stream
from magical.observe import NAMED

RECENT = 100  # episodes over which the reported score is averaged
EVALUATION_SEED = 1  # not the seeds that results are reported for

Metrics = dict[str, float | str]


@dataclass(frozen=True, kw_only=True)
class PPOConfig(ReinforcementConfig):
    """Settings of proximal policy optimisation; the defaults are Table 4's."""

    algorithm: ClassVar[str] = "ppo"
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "paper": {},
        # The environment's rewards come later than a discriminator's: look further ahead.
        "quick": {**QUICK, "minibatch_size": 128, "discount": 0.95, "gae_lambda": 0.95},
    }

    reward: str = option("dense", "the environment's reward: dense or score")

    def __post_init__(self) -> None:
        super().__post_init__()
        self.require_one_of("reward", ("dense", "score"))

    def check_observation(self) -> None:
        """Raise unless the observation is one array of images, or `state`."""
        if self.observation not in NAMED:
            super().check_observation()


def train(config: PPOConfig, run: Run) -> None:
    """Learn from the environment's reward."""
    with Learner(config, run, reward=config.reward) as learner:
        for number in learner.numbers():
            samples = learner.collect(number)
            metrics = learner.improve(number, samples, samples.rewards)
            if learner.finish(number, metrics):
                break


class Learner:
    """A policy, its optimiser, its worlds, and the run they belong to.

    With `before`, the run had so many steps of another kind before the first update.
    """

    def __init__(
        self, config: ReinforcementConfig, run: Run, reward: Any = "none", before: int = 0
    ) -> None:
        self.config = config
        self.run = run
        self.before = before
        self.device = choose_device(config.device)
        self.network = make_policy(config).to(self.device)
        self.optimizer = Adam(self.network.parameters(), config.learning_rate, fused=True)
        states = len(config.input_shape) == 1
        # Positions need more digits than pixels.
        precision = "float32" if states and config.precision == "auto" else config.precision
        self.compute = run.compute(self.device, precision, self._probe)
        both = self.network.both
        self._both = torch.compile(both) if config.compile else both
        self._stack = ExitStack()
        if states:
            self._stack.enter_context(one_thread())
        self.sampler = self._stack.enter_context(Sampler(config, self.device, reward))
        self._recent: deque[tuple[int, float]] = deque(maxlen=RECENT)
        self._watch = Watch()
        self._one_action = False
        self._seconds = {"sample": 0.0, "policy": 0.0}

    def __enter__(self) -> Self:
        try:
            self._begin()
        except BaseException:
            self._stack.close()
            raise
        return self

    def __exit__(self, *error: object) -> None:
        self._stack.close()

    def _begin(self) -> None:
        saved = self.run.saved or {}
        if "learner" not in saved:
            self.sampler.begin()
            return
        load_module(self.network, saved["policy"], str(self.run.folder))
        tree = saved["learner"]
        load_optimizer(self.optimizer, tree["optimizer"])
        self.sampler.load(tree["sampler"])
        self._recent.extend((int(task), score) for task, score in tree["recent"])
        self._watch = Watch(tree["watch"])

    def numbers(self) -> Iterator[int]:
        """The numbers of the updates that are still to be done."""
        yield from range(max(self.run.step - self.before, 0), self.config.updates)

    def act(self, observations: Tensor, tasks: Tensor) -> tuple[Tensor, Tensor]:
        """Logits (B, 18) and values (B,) of observations as the environment gives them."""
        return self._forward(as_inputs(observations), tasks)

    def _forward(self, inputs: Tensor, tasks: Tensor) -> tuple[Tensor, Tensor]:
        with self.compute.autocast():
            logits, values = self._both(inputs, tasks)
        return logits.float(), values.float()

    def collect(self, number: int) -> Samples:
        """Experience of the present policy."""
        began = time.perf_counter()
        samples = self.sampler.collect(self.act, stream(self.config.seed, Purpose.ACTIONS, number))
        self._recent.extend(samples.scores)
        self._one_action = bool((samples.actions == samples.actions[0, 0]).all())
        self._seconds["sample"] = time.perf_counter() - began
        return samples

    def improve(self, number: int, samples: Samples, rewards: Tensor) -> Metrics:
        """Improve the policy by update `number`, with rewards (T, N) for the samples."""
        began = time.perf_counter()
        config = self.config
        batch = as_batch(samples, rewards, config)
        if self.compute.precision == "bfloat16":  # as the network's first layer would have it
            batch = batch._replace(inputs=batch.inputs.bfloat16())
        left = 1.0 - number / config.updates if config.anneal else 1.0
        for group in self.optimizer.param_groups:
            group["lr"] = config.learning_rate * left
        rng = stream(config.seed, Purpose.MINIBATCHES, number)
        tasks = np.tile(self.sampler.task_of, config.time_steps)
        sums = torch.zeros(4, device=self.device)
        for _ in range(config.epochs):
            order = torch.from_numpy(spread(tasks, rng)).to(self.device)
            for rows in torch.split(order, config.minibatch_size):
                sums += self._step(batch.rows(rows), config.clip * left) * len(rows)
        sums /= config.epochs * len(tasks)
        names = ("policy_loss", "value_loss", "entropy", "clip_fraction")
        metrics: Metrics = dict(zip(names, sums.tolist(), strict=True))
        self._seconds["policy"] = time.perf_counter() - began
        return {
            "reward": rewards.mean().item(),
            "reward_std": rewards.std(correction=0).item(),
            **metrics,
            "explained_variance": explained_variance(samples.values.flatten(), batch.returns),
        }

    def _step(self, batch: Batch, clip: float) -> Tensor:
        """One step of the optimiser; returns the four parts of `ppo_loss`."""
        logits, values = self._forward(batch.inputs, batch.tasks)
        loss, parts = ppo_loss(logits, values, batch, clip, self.config.entropy_bonus)
        self.optimizer.zero_grad()
        torch.autograd.backward(loss)
        nn.utils.clip_grad_norm_(self.network.parameters(), self.config.max_grad_norm)
        self.optimizer.step()
        return parts

    def finish(
        self, number: int, metrics: Metrics, more: Callable[[], Tree] = dict, **seconds: float
    ) -> bool:
        """Report update `number`, leave checkpoints (`more` adds to them); whether to stop."""
        config, done = self.config, number + 1
        step = self.before + done
        ends = done == config.updates or self.run.stops(step)
        for name, value in {**self._seconds, **seconds}.items():
            metrics[f"{name}_seconds"] = value
        metrics |= self._scores(done)
        warning = self._watch.warnings(metrics, self._one_action)
        said: Metrics = {"warning": warning} if warning else {}
        steps = done * config.steps_per_update
        self.run.log(step, config.total, **said, environment_steps=steps, **metrics)
        self.run.require_finite(step, metrics)
        if ends or done % config.checkpoint_every == 0:
            self.run.checkpoint(step, {**self._tree(), **more()})
        if ends or "evaluation_score" in metrics:
            draw_curves(self.run.folder / METRICS)
        return ends

    def _scores(self, done: int) -> Metrics:
        """The mean score of recent episodes and, now and then, of an evaluation."""
        config = self.config
        metrics: Metrics = {}
        if self._recent:
            metrics["score"] = mean_by_task(self._recent)
        every = config.evaluate_every
        if every and (done % every == 0 or done == config.updates):
            metrics["evaluation_score"] = self._evaluate()
        return metrics

    def _evaluate(self) -> float:
        config = self.config
        shown = config.observation, config.observation_spec
        scores = evaluate(
            NetworkPolicy(self.network, config.tasks, *shown, self.compute),
            [EnvId(task, "Demo") for task in config.tasks],
            rollouts=config.evaluation_rollouts,
            seed=EVALUATION_SEED,
            workers=config.workers,
        )
        self.network.train()
        return float(np.mean([score.score for score in scores]))

    def _tree(self) -> Tree:
        learner = {
            "optimizer": optimizer_tree(self.optimizer),
            "sampler": self.sampler.tree(),
            "recent": list(self._recent),
            "watch": self._watch.seen,
        }
        return {"policy": self.network.state_dict(), "learner": learner}

    def _probe(self) -> Tensor:
        """A forward pass of a minibatch, to measure precisions with."""
        shape, size = self.config.input_shape, self.config.minibatch_size
        tasks = torch.zeros(size, dtype=torch.int64, device=self.device)
        logits, values = self.network.both(torch.zeros(size, *shape, device=self.device), tasks)
        return logits.sum() + values.sum()


def ppo_loss(
    logits: Tensor, values: Tensor, batch: Batch, clip: float, entropy_bonus: float
) -> tuple[Tensor, Tensor]:
    """The loss to be minimised, and (4,): policy loss, value loss, entropy, clipped fraction.

    Loss = policy loss + value loss - bonus * entropy, where the policy loss is minus the mean of
    min(ratio * A, clip(ratio, 1 - clip, 1 + clip) * A), the value loss half the mean squared
    error. `logits` (B, 18) and `values` (B,) are of the present network.
    """
    log_probs = logits.log_softmax(dim=1)
    chosen = log_probs.gather(1, batch.actions[:, None]).squeeze(1)
    ratio = (chosen - batch.log_probs).exp()
    clipped = ratio.clamp(1.0 - clip, 1.0 + clip)
    policy_loss = -torch.minimum(ratio * batch.advantages, clipped * batch.advantages).mean()
    value_loss = 0.5 * (values - batch.returns).square().mean()
    entropy = -(log_probs.exp() * log_probs).sum(dim=1).mean()
    loss = policy_loss + value_loss - entropy_bonus * entropy
    outside = ((ratio - 1.0).abs() > clip).float().mean()
    return loss, torch.stack([policy_loss, value_loss, entropy, outside]).detach()


def make_policy(config: ReinforcementConfig) -> ActorCritic:
    """The network, with first weights from the seed; no batch norm (appendix B)."""
    width, shape = get_width(config.network), config.input_shape
    with seeded_weights(config.seed):
        trunk = StateTrunk(*shape, width.linear) if len(shape) == 1 else Trunk(width, shape)
        network = ActorCritic(trunk, len(config.tasks))
        if config.first_weights == "centred" and isinstance(trunk, Trunk):
            centre(network)
        return network


ALGORITHM = Algorithm(PPOConfig, train, make_policy)
