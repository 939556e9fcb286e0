"""Learning by acting in environments: rollouts, learned rewards, metrics, evaluations."""

import time
from collections import deque
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.optim import Adam

from magical.envs import EnvId
from magical.envs.env import Reward
from magical.envs.seeds import sample_training_seeds
from magical.envs.vector import MagicalVectorEnv
from magical.errors import InvalidConfigError
from magical.evaluation.protocol import Evaluation
from magical.evaluation.rollouts import RepeatedEvaluation
from magical.observe import ObservationSpec
from magical.runs.sources import INTERACTION
from magical.scene import NUM_ACTIONS
from magical.tasks import Horizon, get_task
from magical_baselines.augmentation.augment import to_unit
from magical_baselines.checkpoints import StateDict
from magical_baselines.config import NonNegativeInt, PaperNetworkConfig, PositiveInt, option
from magical_baselines.models import PolicyNetwork, sample_actions
from magical_baselines.policy import NetworkPolicy
from magical_baselines.training import Purpose, Run, stream

Forward = Callable[[Tensor, Tensor], tuple[Tensor, Tensor]]  # -> logits (B, 18), values (B,)
EpisodeScores = tuple[tuple[int, float], ...]  # task and score of each episode that ended
Metrics = dict[str, float | str]

EVALUATION_SEED = 1  # of the evaluations during training; not the seed of reported results
EVALUATION_ROLLOUTS = 20  # per task
RECENT_EPISODES = 100  # over which the logged score is averaged
COLLAPSE_UPDATES = 50  # consecutive updates with a symptom before a warning
CHANCE = 0.5
NEAR_CHANCE = 0.05  # a discriminator's accuracy this close to chance counts as chance
FLOOR = 1e-3  # smallest standard deviation that rewards are divided by (docs/specification.md, 10)
PUBLISHED_FLOOR = 1e-5  # the published floor, 1e-3, applies to the running deviation / 0.01


@dataclass(frozen=True, kw_only=True)
class InteractionConfig(PaperNetworkConfig):
    """Options of all algorithms that act in environments."""

    total_steps: PositiveInt = option(1_000_000, "total environment steps")
    num_envs: PositiveInt = option(
        32, "N: parallel environments, equally many for each task if they can be"
    )
    num_steps: PositiveInt = option(8, "T: steps of each environment per update")
    workers: NonNegativeInt | None = option(None, "environment processes (default: one per core)")
    evaluate_every: NonNegativeInt = option(200, "updates between evaluations; 0: never")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.policy_updates < 1:
            raise InvalidConfigError(
                f"total_steps: expected at least the {self.steps_per_update} of one "
                f"update (num_envs x num_steps), found {self.total_steps}"
            )
        if self.num_envs < len(self.tasks):
            raise InvalidConfigError(
                f"num_envs: expected at least one for each of {len(self.tasks)} tasks, "
                f"found {self.num_envs}"
            )

    def require_halves(self, option: str, size: int) -> None:
        """Raise `InvalidConfigError` unless a batch has two halves with samples of every task."""
        if size < 2 * len(self.tasks) or size % 2:
            raise InvalidConfigError(
                f"{option}: expected an even number, at least two for each task, found {size}"
            )

    @property
    def learned_from(self) -> tuple[str, ...]:
        return (*super().learned_from, INTERACTION)

    @property
    def steps_per_update(self) -> int:
        return self.num_envs * self.num_steps

    @property
    def policy_updates(self) -> int:
        return self.total_steps // self.steps_per_update

    @property
    def num_updates(self) -> int:
        """The policy's; an algorithm may have other steps before them."""
        return self.policy_updates

    @property
    def num_threads(self) -> int:
        return self.threads or int(self.observes_vectors)

    @property
    def env_horizon(self) -> Horizon:
        """The horizon, as passed to the environments."""
        return None


@dataclass(frozen=True, slots=True)
class Rollout:
    """T steps of N environments under one policy."""

    observations: Tensor  # (T, N, ...), before each action, in the network's layout
    actions: Tensor  # (T, N) int64
    log_probs: Tensor  # (T, N) float32, of the actions under the policy that chose them
    values: Tensor  # (T, N) float32, of the observations
    next_values: Tensor  # (T, N), of the next observations; 0 after the end unless bootstrapped
    rewards: Tensor  # (T, N) float32, the environment's
    dones: Tensor  # (T, N) bool, at the last step of an episode
    tasks: Tensor  # (N,) int64, each environment's position in the configuration's tasks
    scores: EpisodeScores


class RolloutEnvs:
    """The Demo variants of the tasks, as equally many as the number of environments allows.

    Observations go to the device and actions come back: one transfer each way per step.

    Attributes:
        task_of: (N,) int64, each environment's position in the configuration's tasks.
        tasks: the same on the device.
        device: where networks compute.
    """

    def __init__(self, config: InteractionConfig, device: str, reward: Reward = "none") -> None:
        """Create N environments with the configuration's tasks, observation and seed."""
        self.task_of = np.sort(np.arange(config.num_envs) % len(config.tasks))  # (N,)
        self.tasks = torch.from_numpy(self.task_of).to(device)
        names = [config.tasks[number] for number in self.task_of]
        self.envs = MagicalVectorEnv(
            [EnvId(name, "Demo") for name in names],
            workers=config.workers,
            observation=config.observation,
            horizon=config.env_horizon,
            reward=reward,
            autoreset_mode="SameStep",
            copy=False,
        )
        self._seed = config.seed
        self._spec: ObservationSpec = config.observation_spec
        self.device = device
        horizons = [get_task(name).resolve_horizon(config.env_horizon) for name in names]
        self._horizons = np.array(horizons)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.envs.close()

    def reset(self) -> None:
        """Start the first episodes, each with a random number of random actions.

        Otherwise all environments of a task would end their episodes in the same update.
        """
        rng = stream(self._seed, Purpose.ENVIRONMENTS)
        seeds = sample_training_seeds(rng, self.envs.num_envs)
        self._observations, _ = self.envs.reset(seed=seeds)
        delays = rng.integers(self._horizons)
        for step in range(delays.max()):
            actions = rng.integers(NUM_ACTIONS, size=self.envs.num_envs)
            self._observations, *_ = self.envs.step(actions, active=step < delays)

    def network_input(self) -> Tensor:
        """The current observations as networks take them, on the device."""
        return to_unit(self.observations().to(self.device))

    def observations(self) -> Tensor:
        """The current observations (N, ...) in the network's layout, still on the CPU."""
        return self._network_input(self._observations)

    def step(
        self, actions: Tensor
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_], Tensor | None, EpisodeScores]:
        """Take actions (N,) int64; environments whose episode ends are reset.

        Returns:
            Rewards (N,), dones (N,), the final observations of the episodes that ended as network
            inputs (None if none ended), and their scores.
        """
        self._observations, rewards, _, dones, infos = self.envs.step(actions.cpu().numpy())
        if not dones.any():
            return rewards, dones, None, ()
        found = infos["final_info"]["eval_score"]
        scores = ((int(self.task_of[i]), float(found[i])) for i in np.flatnonzero(dones))
        final = self._network_input(np.stack(infos["final_obs"][dones]))
        return rewards, dones, final, tuple(scores)

    def _network_input(self, observations: Any) -> Tensor:
        return torch.from_numpy(self._spec.network_input(observations))

    def state_dict(self) -> StateDict:
        return {"envs": [self.envs.get_state(row) for row in range(self.envs.num_envs)]}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        observations = [self.envs.set_state(row, env) for row, env in enumerate(state["envs"])]
        self._observations = np.stack(observations)


def collect_rollout(
    envs: RolloutEnvs, forward: Forward, num_steps: int, bootstrap: bool, rng: np.random.Generator
) -> Rollout:
    """Step the environments T times with actions sampled from the logits of `forward`.

    With `bootstrap`, the value of an episode's final observation is also estimated.
    """
    shape, device = (num_steps, len(envs.tasks)), envs.device  # (T, N)
    uniforms = torch.from_numpy(rng.random(shape, np.float32)).to(device)
    first = torch.empty_like(envs.observations())  # in their memory layout, but without gaps
    observations = torch.empty_strided(
        (num_steps, *first.shape),
        (first.numel(), *first.stride()),
        dtype=first.dtype,
        device=device,
    )
    actions = torch.empty(shape, dtype=torch.int64, device=device)
    log_probs, values, final_values = torch.zeros((3, *shape), device=device)
    rewards, dones = np.empty(shape, np.float32), np.empty(shape, np.bool_)
    scores: EpisodeScores = ()
    with torch.no_grad():
        for t in range(num_steps):
            observations[t] = envs.observations()
            logits, values[t] = forward(to_unit(observations[t]), envs.tasks)
            actions[t], log_probs[t] = sample_actions(logits, uniforms[t])
            rewards[t], dones[t], final, ended = envs.step(actions[t])
            scores += ended
            if bootstrap and final is not None:
                rows = torch.from_numpy(np.flatnonzero(dones[t])).to(device)
                final_values[t, rows] = forward(to_unit(final.to(device)), envs.tasks[rows])[1]
        _, last = forward(envs.network_input(), envs.tasks)
    ends = torch.from_numpy(dones).to(device)
    return Rollout(
        observations,
        actions,
        log_probs,
        values,
        torch.where(ends, final_values, torch.cat([values[1:], last[None]])),
        torch.from_numpy(rewards).to(device),
        ends,
        envs.tasks,
        scores,
    )


def shuffle_evenly(tasks: NDArray[np.int64], rng: np.random.Generator) -> NDArray[np.int64]:
    """A random permutation (B,) of samples of tasks (B,), each stretch of it balanced by task."""
    positions = np.empty(len(tasks))
    for task in np.unique(tasks):
        rows = rng.permutation(np.flatnonzero(tasks == task))
        positions[rows] = (np.arange(len(rows)) + 0.5) / len(rows)
    return np.argsort(positions, kind="stable")


class RewardNormaliser(nn.Module):
    """Normalises learned rewards to mean 0 and a fixed standard deviation (appendix B, Table 4).

    The statistics are of the whole run, separate for each task.
    """

    # One number per task, (K,), in double precision, as they sum over a million rewards.
    count: Tensor
    mean: Tensor
    squares: Tensor  # sums of squared deviations from the mean

    def __init__(self, num_tasks: int, std: float, *, published: bool = False) -> None:
        """Start without statistics; the published code has another floor of standard deviations."""
        super().__init__()
        self.target = std
        self.floor = PUBLISHED_FLOOR if published else FLOOR
        for name in ("count", "mean", "squares"):
            self.register_buffer(name, torch.zeros(num_tasks, dtype=torch.float64))

    def forward(self, rewards: Tensor, tasks: Tensor) -> Tensor:
        """Update the statistics with rewards (T, N) of tasks (N,), and normalise the rewards."""
        # Merge the mean and the squared deviations into the running ones.
        exact = rewards.double()
        member = nn.functional.one_hot(tasks, len(self.count)).double()  # (N, K)
        count = len(exact) * member.sum(dim=0)
        mean = exact.sum(dim=0) @ member / count.clamp(min=1)
        squares = (exact - mean[tasks]).square().sum(dim=0) @ member
        total = (self.count + count).clamp(min=1)
        change = mean - self.mean
        self.squares += squares + change.square() * self.count * count / total
        self.mean += change * count / total
        self.count += count
        std = (self.squares / self.count.clamp(min=1)).sqrt().clamp(min=self.floor)  # (K,)
        normalised = (rewards - self.mean[tasks]) / std[tasks] * self.target
        return normalised.to(rewards.dtype)


class Monitor:
    """Collects the scores and durations of updates, and warns of a collapse."""

    def __init__(self) -> None:
        self._recent: deque[tuple[int, float]] = deque(maxlen=RECENT_EPISODES)
        self._counts: dict[str, int] = {}  # consecutive updates with each symptom
        self._seconds: dict[str, float] = {}
        self._one_action = False

    def add_rollout(self, actions: Tensor, scores: EpisodeScores) -> None:
        """Add the scores of finished episodes, and check whether the actions (T, N) differ."""
        self._recent.extend(scores)
        self._one_action = bool((actions == actions[0, 0]).all())

    @contextmanager
    def timed(self, part: str) -> Iterator[None]:
        """Measure the duration of a part of the update."""
        start = time.perf_counter()
        yield
        self._seconds[part] = time.perf_counter() - start

    def metrics(self, accuracy: Any = None) -> Metrics:
        """Durations in seconds, the mean score once an episode has ended, and warnings.

        `warning` is there if this update, of which `accuracy` is the discriminator's, is at least
        the 50th in a row with a symptom of a collapse.
        """
        found: Metrics = {f"{part}_seconds": spent for part, spent in self._seconds.items()}
        if self._recent:
            found["score"] = mean_by_task(self._recent)
        symptoms = {"one action": self._one_action}
        if accuracy is not None:
            symptoms["discriminator at chance"] = abs(accuracy - CHANCE) <= NEAR_CHANCE
            symptoms["discriminator always right"] = accuracy == 1.0
        self._counts = {name: self._counts.get(name, 0) + 1 for name, on in symptoms.items() if on}
        lasting = [(name, n) for name, n in self._counts.items() if n >= COLLAPSE_UPDATES]
        if lasting:
            found["warning"] = ", ".join(f"{name} for {n} updates" for name, n in lasting)
        return found

    def state_dict(self) -> StateDict:
        return {"recent": list(self._recent), "collapse": self._counts}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        self._recent.extend((int(task), score) for task, score in state["recent"])
        self._counts = {name: int(count) for name, count in state["collapse"].items()}


def mean_by_task(scores: Collection[tuple[int, float]]) -> float:
    """The mean over tasks of each task's mean score."""
    tasks = {task for task, _ in scores}
    means = [np.mean([score for t, score in scores if t == task]) for task in tasks]
    return float(np.mean(means))


def explained_variance(values: Tensor, returns: Tensor) -> float:
    """1 - Var[returns - values] / Var[returns], both (B,); 0 if the returns do not vary."""
    variance = returns.var(correction=0)
    residual = (returns - values).var(correction=0)
    return (1.0 - residual / variance).item() if variance > 0 else 0.0


class InteractionTrainer:
    """A policy, its optimiser, and the environments of the tasks' Demo variants.

    It is a context manager: on entry, the environments are opened, and started or resumed from the
    run's checkpoint. Evaluation environments are created for the first evaluation, then reused.
    """

    envs: RolloutEnvs
    _stack: ExitStack
    _evaluation: RepeatedEvaluation | None = None

    def __init__(
        self,
        config: InteractionConfig,
        run: Run,
        network: PolicyNetwork,
        learning_rate: float,
        reward: Reward = "none",
    ) -> None:
        """Create a trainer that optimises a network with Adam."""
        self.config, self.run, self.compute = config, run, run.compute
        self.previous_steps = config.num_updates - config.policy_updates  # such as pretraining
        self.device = self.compute.device
        self.network = network.to(self.device)
        self.optimizer = Adam(self.network.parameters(), learning_rate, fused=True)
        self.monitor = Monitor()
        self._reward = reward

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            self.envs = stack.enter_context(RolloutEnvs(self.config, self.device, self._reward))
            restored = self.run.keep(
                policy=self.network, optimizer=self.optimizer, envs=self.envs, monitor=self.monitor
            )
            if not restored:
                self.envs.reset()
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *error: object) -> None:
        self._stack.close()

    def remaining_updates(self) -> range:
        """The numbers of the policy's remaining updates."""
        first = max(self.run.step - self.previous_steps, 0)
        return range(first, self.config.policy_updates)

    def finish_update(self, update: int, metrics: Metrics) -> bool:
        """Evaluate, log and save a checkpoint, each if due; true if the run stops."""
        config, done = self.config, update + 1
        metrics |= self.monitor.metrics(metrics.get("discriminator_accuracy"))
        every, last = config.evaluate_every, done == config.policy_updates
        if every and (done % every == 0 or last):
            metrics["evaluation_score"] = self._evaluate()
        metrics["environment_steps"] = done * config.steps_per_update
        return self.run.finish_step(self.previous_steps + done, lambda: metrics, last=last)

    def _evaluate(self) -> float:
        """The mean score of the current weights; the network is in training mode afterwards."""
        if not self._evaluation:
            config = self.config
            policy = NetworkPolicy(self.network, config, self.compute)
            how = Evaluation(
                env_ids=tuple(EnvId(task, "Demo") for task in config.tasks),
                rollouts=EVALUATION_ROLLOUTS,
                seed=EVALUATION_SEED,
                horizon=config.env_horizon,
            )
            self._evaluation = RepeatedEvaluation(policy, how, config.workers)
            self._stack.callback(self._evaluation.close)
        self.network.eval()
        scores = self._evaluation.scores()
        self.network.train()
        return float(np.mean([score.score for score in scores]))
