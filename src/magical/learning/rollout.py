"""Collecting experience: worlds that a policy acts in, a fixed number of steps at a time."""

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
from magical.learning.augment import to_unit
from magical.learning.checkpoints import Tree
from magical.learning.reinforcement import ReinforcementConfig
from magical.learning.streams import Purpose, stream
from magical.observe import ObservationSpec
from magical.scene import NUM_ACTIONS
from magical.tasks import get_task

# Observations as the environment gives them and tasks -> logits (B, 18) and values (B,).
Act = Callable[[Tensor, Tensor], tuple[Tensor, Tensor]]


@dataclass(frozen=True, slots=True)
class Samples:
    """What T steps of N worlds gave."""

    observations: Tensor  # (T, N, ...), before each action, in the network's layout
    actions: Tensor  # (T, N) int64
    log_probs: Tensor  # (T, N) float32, of the actions when they were chosen
    values: Tensor  # (T, N) float32, of the observations
    next_values: Tensor  # (T, N), of what followed; 0 at an episode's end without bootstrap
    rewards: Tensor  # (T, N) float32, the environment's
    ended: Tensor  # (T, N) bool, at an episode's last step
    tasks: Tensor  # (N,) int64, each world's position in the configuration's tasks
    scores: tuple[tuple[int, float], ...]  # task and score of each episode that ended


class Sampler:
    """Worlds of the tasks' Demo variants, and where they stand.

    On a GPU there is one transfer each way for each step: observations there, actions back.
    """

    def __init__(self, config: ReinforcementConfig, device: str, reward: Reward = "none") -> None:
        self.task_of = np.sort(np.arange(config.num_envs) % len(config.tasks))  # (N,)
        self.tasks = torch.from_numpy(self.task_of).to(device)
        names = [config.tasks[number] for number in self.task_of]
        self.envs = MagicalVectorEnv(
            [EnvId(name, "Demo") for name in names],
            workers=config.workers,
            observation=config.observation,
            reward=reward,
            autoreset_mode="SameStep",
            copy=False,
        )
        self._config = config
        self._spec: ObservationSpec = config.observation_spec
        self._device = device
        self._horizons = np.array([get_task(name).horizon for name in names])

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.envs.close()

    def begin(self) -> None:
        """The first episodes, seeded; if so configured, each after some random steps of its own.

        Otherwise all worlds of a task would end their episodes in the same update.
        """
        rng = stream(self._config.seed, Purpose.ENVIRONMENTS)
        seeds = sample_training_seeds(rng, self.envs.num_envs)
        self._present, _ = self.envs.reset(seed=seeds)
        waits = rng.integers(self._horizons) * self._config.decorrelate
        for moment in range(waits.max()):
            actions = rng.integers(NUM_ACTIONS, size=self.envs.num_envs)
            self._present, *_ = self.envs.step(actions, active=moment < waits)

    def collect(self, act: Act, rng: np.random.Generator) -> Samples:
        """Let `act` choose among its distributions for `time_steps` steps of every world."""
        steps, worlds = self._config.time_steps, self.envs.num_envs
        draws = torch.from_numpy(rng.random((steps, worlds), np.float32)).to(self._device)
        first = self._network_input(self._present)
        observations = torch.empty_strided(
            (steps, *first.shape),
            (first.numel(), *first.stride()),
            dtype=first.dtype,
            device=self._device,
        )
        actions = torch.empty((steps, worlds), dtype=torch.int64, device=self._device)
        log_probs, values, final_values = torch.zeros((3, steps, worlds), device=self._device)
        rewards = np.empty((steps, worlds), np.float32)
        ended = np.empty((steps, worlds), np.bool_)
        scores: list[tuple[int, float]] = []
        with torch.no_grad():
            for t in range(steps):
                observations[t] = self._network_input(self._present)
                logits, values[t] = act(observations[t], self.tasks)
                actions[t], log_probs[t] = choose(logits, draws[t])
                self._present, rewards[t], _, ended[t], infos = self.envs.step(
                    actions[t].cpu().numpy()
                )
                if ended[t].any():
                    scores += self._scores(infos, ended[t])
                    if self._config.bootstrap:
                        self._value_ends(act, infos, ended[t], final_values[t])
            _, last = act(self._network_input(self._present).to(self._device), self.tasks)
        over = torch.from_numpy(ended).to(self._device)
        following = torch.cat([values[1:], last.float()[None]])
        return Samples(
            observations,
            actions,
            log_probs,
            values,
            torch.where(over, final_values, following),
            torch.from_numpy(rewards).to(self._device),
            over,
            self.tasks,
            tuple(scores),
        )

    def tree(self) -> Tree:
        """Where every world stands, for a checkpoint."""
        return {"worlds": [self.envs.get_state(row) for row in range(self.envs.num_envs)]}

    def load(self, tree: Mapping[str, Any]) -> None:
        """Continue from what `tree` returned."""
        shown = [self.envs.set_state(row, state) for row, state in enumerate(tree["worlds"])]
        self._present = np.stack(shown)

    def _network_input(self, observations: Any) -> Tensor:
        return torch.from_numpy(self._spec.network_input(observations))

    def _scores(
        self, infos: Mapping[str, Any], ended: NDArray[np.bool_]
    ) -> list[tuple[int, float]]:
        scores = infos["final_info"]["eval_score"]
        return [(int(self.task_of[row]), float(scores[row])) for row in np.flatnonzero(ended)]

    def _value_ends(
        self, act: Act, infos: Mapping[str, Any], ended: NDArray[np.bool_], out: Tensor
    ) -> None:
        shown = self._network_input(np.stack(infos["final_obs"][ended])).to(self._device)
        rows = torch.from_numpy(np.flatnonzero(ended)).to(self._device)
        out[rows] = act(shown, self.tasks[rows])[1].float()


def choose(logits: Tensor, draws: Tensor) -> tuple[Tensor, Tensor]:
    """Actions (B,) int64 and their log-probabilities, by uniform draws (B,) in [0, 1)."""
    log_probs = logits.float().log_softmax(dim=1)
    below = log_probs.exp().cumsum(dim=1)  # (B, 18)
    actions = (draws[:, None] * below[:, -1:] >= below).sum(dim=1)
    actions = actions.clamp_(max=logits.shape[1] - 1)
    return actions, log_probs.gather(1, actions[:, None]).squeeze(1)


def as_inputs(observations: Tensor) -> Tensor:
    """Observations (B, ...) in the network's layout as float: images scaled to [0, 1]."""
    return to_unit(observations)
