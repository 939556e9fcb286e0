"""Rollouts, and the environments in which they are collected."""

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
from magical.observe import ObservationSpec
from magical.scene import NUM_ACTIONS
from magical.tasks import get_task
from magical_baselines.augmentation.augment import to_unit
from magical_baselines.models import sample_actions
from magical_baselines.reinforcement.interaction import InteractionConfig
from magical_baselines.running.checkpoints import StateDict
from magical_baselines.running.streams import Purpose, stream

Forward = Callable[[Tensor, Tensor], tuple[Tensor, Tensor]]  # -> logits (B, 18), values (B,)
EpisodeScores = tuple[tuple[int, float], ...]  # task and score of each episode that ended


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
        settings = config.interaction
        self.task_of = np.sort(np.arange(settings.num_envs) % len(config.tasks))  # (N,)
        self.tasks = torch.from_numpy(self.task_of).to(device)
        names = [config.tasks[number] for number in self.task_of]
        self.envs = MagicalVectorEnv(
            [EnvId(name, "Demo") for name in names],
            workers=settings.workers,
            observation=config.observation,
            horizon=settings.env_horizon,
            reward=reward,
            autoreset_mode="SameStep",
            copy=False,
        )
        self._seed = config.seed
        self._spec: ObservationSpec = config.observation_spec
        self.device = device
        horizons = [get_task(name).resolve_horizon(settings.env_horizon) for name in names]
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
        for time in range(delays.max()):
            actions = rng.integers(NUM_ACTIONS, size=self.envs.num_envs)
            self._observations, *_ = self.envs.step(actions, active=time < delays)

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
        """The states of all environments."""
        return {"envs": [self.envs.get_state(row) for row in range(self.envs.num_envs)]}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore what `state_dict` returned."""
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
        _, last = forward(to_unit(envs.observations().to(device)), envs.tasks)
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
