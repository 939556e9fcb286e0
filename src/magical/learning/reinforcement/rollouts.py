"""The environments that rollouts are collected in, and the rollouts."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from magical.envs import EnvId
from magical.envs.env import Reward
from magical.envs.seeds import sample_training_seeds
from magical.envs.vector import MagicalVectorEnv
from magical.learning.augmentation.augment import to_unit
from magical.learning.config import Config
from magical.learning.models import sample_actions
from magical.learning.reinforcement.staging import Staging
from magical.learning.running.checkpoints import StateDict
from magical.learning.running.streams import Purpose, stream
from magical.observe import ObservationSpec
from magical.scene import NUM_ACTIONS
from magical.tasks import Horizon, get_task

Forward = Callable[[Tensor, Tensor], tuple[Tensor, Tensor]]  # -> logits (B, 18), values (B,)


@dataclass(frozen=True, slots=True)
class Rollout:
    """T steps of N environments, under one policy."""

    observations: Tensor  # (T, N, ...), before each action, in the network's layout
    actions: Tensor  # (T, N) int64
    log_probs: Tensor  # (T, N) float32, of the actions under the policy that chose them
    values: Tensor  # (T, N) float32, of the observations
    next_values: Tensor  # (T, N), of the next observations; 0 after the end unless bootstrapped
    rewards: Tensor  # (T, N) float32, the environment's
    dones: Tensor  # (T, N) bool, at the last step of an episode
    tasks: Tensor  # (N,) int64, each environment's position in the configuration's tasks
    scores: tuple[tuple[int, float], ...]  # task and score of each episode that ended


@dataclass(frozen=True, slots=True)
class Step:
    """What one step of the N environments returned."""

    rewards: NDArray[np.float64]  # (N,)
    dones: NDArray[np.bool_]  # (N,)
    final_observations: Tensor | None  # (number of dones, ...), network inputs; None without dones
    scores: tuple[tuple[int, float], ...]  # task and score of each episode that ended


class RolloutEnvs:
    """The Demo variants of the tasks, split evenly between the sub-environments.

    Observations go to the device and actions come back: one transfer each way per step.

    Attributes:
        task_of: (N,) int64, each environment's position in the configuration's tasks.
        tasks: the same on the device.
        device: where networks compute.
        staging: copies observations there.
    """

    def __init__(
        self,
        config: Config,
        num_envs: int,
        device: str,
        *,
        horizon: Horizon = None,
        workers: int | None = None,
        reward: Reward = "none",
    ) -> None:
        """Create the environments.

        Args:
            config: tasks, observation and seed.
            num_envs: N.
            device: where networks compute.
            horizon: of episodes.
            workers: processes; by default one for each core.
            reward: the environment's.
        """
        self.task_of = np.sort(np.arange(num_envs) % len(config.tasks))  # (N,)
        self.tasks = torch.from_numpy(self.task_of).to(device)
        names = [config.tasks[number] for number in self.task_of]
        self.envs = MagicalVectorEnv(
            [EnvId(name, "Demo") for name in names],
            workers=workers,
            observation=config.observation,
            horizon=horizon,
            reward=reward,
            autoreset_mode="SameStep",
            copy=False,
        )
        self._seed = config.seed
        self._spec: ObservationSpec = config.observation_spec
        self.device = device
        self.staging = Staging(device)
        self._horizons = np.array([get_task(name).resolve_horizon(horizon) for name in names])

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.envs.close()

    def reset(self) -> None:
        """Start the first episodes, each with a number of random actions.

        Otherwise all environments of a task would end their episodes in the same update.
        """
        rng = stream(self._seed, Purpose.ENVIRONMENTS)
        seeds = sample_training_seeds(rng, self.envs.num_envs)
        self._observations, _ = self.envs.reset(seed=seeds)
        delays = rng.integers(self._horizons)
        for time in range(delays.max()):
            actions = rng.integers(NUM_ACTIONS, size=self.envs.num_envs)
            self._observations, *_ = self.envs.step(actions, active=time < delays)

    def observations(self) -> Tensor:
        """The present observations (N, ...) in the network's layout, still on the CPU."""
        return self._network_input(self._observations)

    def step(self, actions: Tensor) -> Step:
        """Take actions (N,) int64; environments whose episode ends are reset."""
        self._observations, rewards, _, dones, infos = self.envs.step(actions.cpu().numpy())
        if not dones.any():
            return Step(rewards, dones, None, ())
        scores = infos["final_info"]["eval_score"]
        return Step(
            rewards,
            dones,
            self._network_input(np.stack(infos["final_obs"][dones])),
            tuple((int(self.task_of[i]), float(scores[i])) for i in np.flatnonzero(dones)),
        )

    def _network_input(self, observations: Any) -> Tensor:
        return torch.from_numpy(self._spec.network_input(observations))

    def state_dict(self) -> StateDict:
        """The states of all environments."""
        return {"envs": [self.envs.get_state(row) for row in range(self.envs.num_envs)]}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore what `state_dict` returned."""
        observations = [self.envs.set_state(row, env) for row, env in enumerate(state["envs"])]
        self._observations = np.stack(observations)


class RolloutBuffer:
    """The storage of a rollout while it is collected, on the environments' device."""

    def __init__(self, num_steps: int, envs: RolloutEnvs) -> None:
        self._envs = envs
        self._staging = envs.staging
        self.shape = num_steps, len(envs.tasks)  # T, N
        first = envs.observations()
        self._observations = torch.empty_strided(  # in the memory layout of the environments
            (num_steps, *first.shape),
            (first.numel(), *first.stride()),
            dtype=first.dtype,
            device=envs.device,
        )
        self._actions = torch.empty(self.shape, dtype=torch.int64, device=envs.device)
        self._log_probs, self._values = torch.zeros((2, *self.shape), device=envs.device)
        # (T, N), of the final observations of episodes that ended; stays 0 unless bootstrapped.
        self.final_values = torch.zeros(self.shape, device=envs.device)
        self._rewards = np.empty(self.shape, np.float32)
        self._dones = np.empty(self.shape, np.bool_)
        self._scores: list[tuple[int, float]] = []

    def add_observations(self, t: int, observations: Tensor) -> Tensor:
        """Store observations (N, ...) of time t; returns them on the device."""
        self._staging.copy(observations, self._observations[t])
        return self._observations[t]

    def add(self, t: int, actions: Tensor, log_probs: Tensor, values: Tensor, step: Step) -> None:
        """Store what was computed from the observations of time t, and the step's result."""
        self._actions[t], self._log_probs[t], self._values[t] = actions, log_probs, values
        self._rewards[t], self._dones[t] = step.rewards, step.dones
        self._scores += step.scores

    def rollout(self, next_values: Tensor) -> Rollout:
        """The full buffer; `next_values` (N,) are of the observations after the last step."""
        dones = torch.from_numpy(self._dones).to(self._envs.device)
        following = torch.cat([self._values[1:], next_values[None]])
        return Rollout(
            self._observations,
            self._actions,
            self._log_probs,
            self._values,
            torch.where(dones, self.final_values, following),
            torch.from_numpy(self._rewards).to(self._envs.device),
            dones,
            self._envs.tasks,
            tuple(self._scores),
        )


def collect_rollout(
    envs: RolloutEnvs, forward: Forward, num_steps: int, bootstrap: bool, rng: np.random.Generator
) -> Rollout:
    """Step the environments T times with actions sampled from the logits of `forward`.

    With `bootstrap`, the value of an episode's final observation is estimated, too.
    """
    buffer = RolloutBuffer(num_steps, envs)
    uniforms = torch.from_numpy(rng.random(buffer.shape, np.float32)).to(envs.device)  # (T, N)
    with torch.no_grad():
        for t in range(num_steps):
            observations = buffer.add_observations(t, envs.observations())
            logits, values = forward(to_unit(observations), envs.tasks)
            actions, log_probs = sample_actions(logits, uniforms[t])
            step = envs.step(actions)
            buffer.add(t, actions, log_probs, values, step)
            if bootstrap and step.final_observations is not None:
                rows = torch.from_numpy(np.flatnonzero(step.dones)).to(envs.device)
                final = to_unit(step.final_observations.to(envs.device))
                buffer.final_values[t, rows] = forward(final, envs.tasks[rows])[1]
        _, next_values = forward(to_unit(envs.observations().to(envs.device)), envs.tasks)
    return buffer.rollout(next_values)


def shuffle_evenly(tasks: NDArray[np.int64], rng: np.random.Generator) -> NDArray[np.int64]:
    """A random permutation (B,) of samples of tasks (B,), every stretch of it balanced by task."""
    positions = np.empty(len(tasks))
    for task in np.unique(tasks):
        rows = rng.permutation(np.flatnonzero(tasks == task))
        positions[rows] = (np.arange(len(rows)) + 0.5) / len(rows)
    return np.argsort(positions, kind="stable")
