"""Replay buffers: what a policy did lately, to sample batches from, with demonstrations."""

import zlib
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from magical.observe import ObservationSpec
from magical_baselines.augmentation.augment import augment
from magical_baselines.augmentation.names import Augmentations
from magical_baselines.checkpoints import StateDict
from magical_baselines.config import DemonstrationConfig
from magical_baselines.data import ExpertData, load_demonstrations, split_evenly
from magical_baselines.training import Run

Numbers = NDArray[np.int64]


class Transitions(NamedTuple):
    """B transitions (s, a, s')."""

    observations: Tensor  # (B, ...), s as a network gets it
    actions: Tensor  # (B,) int64
    next_observations: Tensor  # (B, ...), s': at the end of an episode its final observation
    ends: Tensor  # (B,) bool, whether the time limit ends the episode with s'
    tasks: Tensor  # (B,) int64, positions in the configuration's tasks

    def augmented(self, which: Augmentations, rng: np.random.Generator) -> "Transitions":
        """With augmented images, those of s and of s' independently."""
        before, after = self.observations, self.next_observations
        observations = augment(before, which, rng)
        return self._replace(
            observations=observations, next_observations=augment(after, which, rng)
        )


def expert_transitions(
    expert: ExpertData, counts: Sequence[int], rng: np.random.Generator
) -> Transitions:
    """Sample `counts[k]` demonstrated transitions of task k, uniformly with replacement."""
    rows = expert.sample_counts(counts, rng)
    actions, tasks = expert.labels(rows)
    ends = expert.ends[torch.from_numpy(rows).to(expert.device)]
    following = expert.images(rows, following=True)
    return Transitions(expert.images(rows), actions, following, ends, tasks)


def load_expert_transitions(config: DemonstrationConfig, run: Run) -> ExpertData:
    """The demonstrated transitions of a run; raises what `load_demonstrations` raises."""
    return ExpertData(
        load_demonstrations(config, run),
        config.tasks,
        config.observation_spec,
        device=run.compute.device,
        transitions=True,
    )


def sample_halves(
    expert: ExpertData, novice: "ReplayBuffer", size: int, num_tasks: int, rng: np.random.Generator
) -> Transitions:
    """Demonstrated transitions, then as many of the policy; the tasks' shares are even."""
    counts = split_evenly(size // 2, num_tasks, rng)
    halves = expert_transitions(expert, counts, rng), novice.sample(counts, rng)
    return Transitions(*map(torch.cat, zip(*halves, strict=True)))


class ReplayBuffer:
    """The newest transitions of N environments, with each frame stored once.

    A stack of four frames takes 110 kB, a single frame 28 kB. The two stacks of a transition have
    three frames in common and share all their frames with neighbouring transitions. A buffer
    therefore holds single frames, numbered in the order of arrival, and a transition is a window of
    frame numbers: without the newest, it is the observation before the action; without the oldest,
    the one after it.
    """

    def __init__(
        self, spec: ObservationSpec, like: Sequence[Tensor], capacity: int, num_tasks: int
    ) -> None:
        """Create an empty buffer for `capacity` frames.

        The frames of each component of the observation are like those in `like`, (F, channels,
        ...), on the same device.
        """
        self._spec, self._capacity, self._num_tasks = spec, capacity, num_tasks
        self._frames = [part.new_zeros((capacity, *part.shape[1:])) for part in like]
        self._stored = 0  # frames in total; number n is, or was, in slot n % capacity
        self._added = 0  # transitions in total, in the same way; never more than frames
        self._windows = np.zeros((capacity, spec.frames + 1), np.int64)
        self._labels = np.zeros((capacity, 3), np.int64)  # action, end, task
        self._current: Numbers = np.zeros((0, spec.frames), np.int64)  # the environments' stacks
        self._rows: list[Numbers] = []  # of each task's transitions

    def start(self, observations: Tensor) -> None:
        """Start from the current observations (N, ...) of the environments.

        Their earlier frames are not stored; the newest frame is repeated instead.
        """
        numbers = self._store(observations)
        self._current = np.repeat(numbers[:, None], self._spec.frames, axis=1)

    def add(
        self,
        actions: Tensor,
        dones: NDArray[np.bool_],
        observations: Tensor,
        final: Tensor | None,
        tasks: Numbers,
    ) -> None:
        """Add a step of N environments, replacing the oldest frames.

        Args:
            actions: (N,), the actions taken.
            dones: (N,), whether the episode ended.
            observations: (N, ...), the current ones; where an episode ended, the next one's first.
            final: the final observations of the episodes that ended; `None` if none ended.
            tasks: (N,), the environments' tasks.
        """
        after = observations
        if final is not None:
            after = observations.clone()
            after[torch.from_numpy(dones)] = final
        windows = np.concatenate([self._current, self._store(after)[:, None]], axis=1)
        rows = np.arange(self._added, self._added + len(windows)) % self._capacity
        self._windows[rows] = windows
        self._labels[rows] = np.stack([actions.cpu().numpy(), dones, tasks], axis=1)
        self._added += len(windows)
        self._rows = []
        self._current = windows[:, 1:]
        if final is not None:
            self._current[dones] = self._store(observations[torch.from_numpy(dones)])[:, None]

    def sample(self, counts: Sequence[int], rng: np.random.Generator) -> Transitions:
        """Sample `counts[k]` transitions of task k, uniformly with replacement."""
        chosen = [rng.choice(of_task, n) for of_task, n in zip(self._by_task, counts, strict=True)]
        rows = np.concatenate(chosen)
        windows, device = self._windows[rows], self._frames[0].device
        actions, ends, tasks = (torch.from_numpy(part).to(device) for part in self._labels[rows].T)
        before, after = self._stacks(windows[:, :-1]), self._stacks(windows[:, 1:])
        return Transitions(before, actions, after, ends.bool(), tasks)

    @property
    def _by_task(self) -> list[Numbers]:
        """The rows of each task's transitions whose frames are all still stored."""
        if not self._rows:
            filled = slice(min(self._added, self._capacity))
            kept = self._windows[filled, 0] >= self._stored - self._capacity
            tasks = self._labels[filled, 2]
            self._rows = [np.flatnonzero(kept & (tasks == k)) for k in range(self._num_tasks)]
        return self._rows

    def _store(self, observations: Tensor) -> Numbers:
        """Store the newest frames of observations (B, ...); returns their numbers (B,)."""
        numbers = np.arange(self._stored, self._stored + len(observations))
        slots = torch.from_numpy(numbers % self._capacity).to(self._frames[0].device)
        last = 0
        for frames, (_, count) in zip(self._frames, self._spec.components, strict=True):
            channels = frames.shape[1]
            last += count * channels
            newest = observations[:, last - channels : last].to(frames.device)
            frames.index_copy_(0, slots, newest)
        self._stored += len(observations)
        return numbers

    def _stacks(self, windows: Numbers) -> Tensor:
        """Observations (B, ...) for the windows (B, frames)."""
        parts = []
        for frames, (_, count) in zip(self._frames, self._spec.components, strict=True):
            slots = windows[:, -count:].reshape(-1) % self._capacity
            found = frames.index_select(0, torch.from_numpy(slots).to(frames.device))
            parts.append(found.view(len(windows), -1, *frames.shape[2:]))
        return parts[0] if len(parts) == 1 else torch.cat(parts, dim=1)

    def state_dict(self) -> StateDict:
        """The buffer's contents."""
        filled = min(self._stored, self._capacity)
        return {
            "stored": self._stored,
            "added": self._added,
            "frames": [pack(frames[:filled]) for frames in self._frames],
            "windows": torch.from_numpy(self._windows[: self._added]),
            "labels": torch.from_numpy(self._labels[: self._added]),
            "current": torch.from_numpy(self._current),
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore what `state_dict` returned."""
        self._stored, self._added = int(state["stored"]), int(state["added"])
        for frames, packed in zip(self._frames, state["frames"], strict=True):
            filled = frames[: min(self._stored, self._capacity)]
            filled.copy_(unpack(packed, filled.dtype, filled.shape))
        self._windows[: self._added] = state["windows"].numpy()
        self._labels[: self._added] = state["labels"].numpy()
        self._current = state["current"].numpy()
        self._rows = []


class RecentRollouts:
    """The newest rollouts of N environments, from which learned rewards get the novice's samples.

    Unlike in `ReplayBuffer`, observations are kept as the rollouts have them.
    """

    _observations: Tensor  # (capacity, T, N, ...), allocated with the first rollout
    _actions: Tensor  # (capacity, T, N)

    def __init__(self, task_of: Numbers, device: str, capacity: int = 4) -> None:
        """Create an empty buffer for `capacity` rollouts of environments with tasks (N,)."""
        self._device, self._capacity, self._task_of = device, capacity, task_of
        self._envs_of = [np.flatnonzero(task_of == number) for number in range(task_of.max() + 1)]
        self._count = 0  # rollouts added in total

    def add(self, observations: Tensor, actions: Tensor) -> None:
        """Add observations (T, N, ...) and actions (T, N), replacing the oldest rollout."""
        if not self._count:
            self._observations = observations.new_zeros((self._capacity, *observations.shape))
            self._actions = actions.new_zeros((self._capacity, *actions.shape))
        self._observations[self._count % self._capacity] = observations
        self._actions[self._count % self._capacity] = actions
        self._count += 1

    def sample(
        self, counts: Sequence[int], rng: np.random.Generator
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Observations (B, ...), actions (B,) and tasks (B,), `counts[k]` of task k."""
        pairs = zip(self._envs_of, counts, strict=True)
        env = np.concatenate([rng.choice(envs, count) for envs, count in pairs])
        rollout = rng.integers(min(self._count, self._capacity), size=len(env))
        time = rng.integers(self._actions.shape[1], size=len(env))
        index = tuple(torch.from_numpy(part).to(self._device) for part in (rollout, time, env))
        tasks = torch.from_numpy(self._task_of[env]).to(self._device)
        return self._observations[index], self._actions[index], tasks

    def state_dict(self) -> StateDict:
        """The buffer's contents."""
        if not self._count:
            return {"count": 0}
        return {
            "count": self._count,
            "dtype": str(self._observations.dtype).removeprefix("torch."),
            "shape": list(self._observations.shape),
            "observations": pack(self._observations),
            "actions": self._actions,
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore what `state_dict` returned."""
        self._count = int(state["count"])
        if self._count:
            plain = unpack(state["observations"], getattr(torch, state["dtype"]), state["shape"])
            self._observations = plain.to(self._device)
            self._actions = state["actions"].to(self._device)


def pack(frames: Tensor) -> Tensor:
    """Compress frames, which are mostly of uniform colour."""
    packed = zlib.compress(frames.cpu().numpy().tobytes(), 1)
    return torch.frombuffer(bytearray(packed), dtype=torch.uint8)


def unpack(packed: Tensor, dtype: torch.dtype, shape: Sequence[int]) -> Tensor:
    """The inverse of `pack`, on the CPU."""
    plain = bytearray(zlib.decompress(packed.numpy().tobytes()))
    return torch.frombuffer(plain, dtype=dtype).view(*shape)
