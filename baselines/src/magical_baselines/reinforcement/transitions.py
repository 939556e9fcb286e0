"""Transitions of demonstrations and of a policy, with each frame stored once.

A stack of four frames takes 110 kB, a single frame 28 kB. The two stacks of a transition have three
frames in common and share all their frames with neighbouring transitions. A buffer therefore holds
single frames, numbered in the order of arrival, and a transition is a window of frame numbers:
without the newest, it is the observation before the action; without the oldest, the one after it.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from magical.demos import Trajectory
from magical.demos.reader import TrajectorySource
from magical.errors import DemonstrationsError
from magical.observe import ObservationSpec
from magical.observe.arrays import stack_indices
from magical_baselines.reinforcement.replay_buffer import pack, unpack
from magical_baselines.running.checkpoints import StateDict

Numbers = NDArray[np.int64]


class Transitions(NamedTuple):
    """B transitions (s, a, s')."""

    observations: Tensor  # (B, ...), s as a network gets it
    actions: Tensor  # (B,) int64
    next_observations: Tensor  # (B, ...), s': at the end of an episode its final observation
    ends: Tensor  # (B,) bool, whether the time limit ends the episode with s'
    tasks: Tensor  # (B,) int64, positions in the configuration's tasks

    def join(self, others: "Transitions") -> "Transitions":
        """These transitions, followed by others."""
        return Transitions(*(torch.cat(pair) for pair in zip(self, others, strict=True)))


class TransitionBuffer:
    """The newest frames of episodes, and the transitions between them, on a device."""

    def __init__(self, spec: ObservationSpec, frames: Sequence[Tensor], num_tasks: int) -> None:
        """Create an empty buffer.

        Args:
            spec: the specification of the observations.
            frames: storage for each component's frames, (capacity, channels, ...).
            num_tasks: number of tasks.
        """
        self._spec = spec
        self._frames = frames
        self._num_tasks = num_tasks
        self._capacity = len(frames[0])
        self._stored = 0  # frames in total; number n is, or was, in slot n % capacity
        self._added = 0  # transitions in total, in the same way; never more than frames
        self._windows = np.zeros((self._capacity, spec.frames + 1), np.int64)
        self._labels = np.zeros((self._capacity, 3), np.int64)  # action, end, task
        self._current: Numbers = np.zeros((0, spec.frames), np.int64)  # the environments' stacks
        self._rows: list[Numbers] = []  # of each task's transitions

    @classmethod
    def of_demonstrations(
        cls,
        demonstrations: Sequence[tuple[str, Trajectory]],
        task_names: Sequence[str],
        spec: ObservationSpec,
        device: str,
    ) -> "TransitionBuffer":
        """A full buffer of demonstrations.

        Steps whose executed action is not the label are left out: their next state results from
        another action.

        Raises:
            DemonstrationsError: no steps of a task are left.
        """
        sources = [TrajectorySource(trajectory) for _, trajectory in demonstrations]
        frames = []
        for component in spec.components:
            read = [component.read(source, np.arange(len(source) + 1)) for source in sources]
            frames.append(torch.from_numpy(np.concatenate(read)).to(device))
        buffer = cls(spec, frames, len(task_names))
        for name, trajectory in demonstrations:
            length, first = len(trajectory), buffer._stored
            steps = np.flatnonzero(trajectory.is_intended)
            windows = first + stack_indices(steps + 1, spec.frames + 1)
            task = np.full(len(steps), task_names.index(name))
            labels = trajectory.labels[steps].astype(np.int64)
            buffer._append(windows, labels, steps == length - 1, task)
            buffer._stored += length + 1
        for name, rows in zip(task_names, buffer._by_task, strict=True):
            if not len(rows):
                raise DemonstrationsError(
                    f"{name}: expected steps in which the demonstrator's own action was executed, "
                    "found none"
                )
        return buffer

    def emptied(self, capacity: int) -> "TransitionBuffer":
        """An empty buffer for frames like these."""
        frames = [part.new_zeros((capacity, *part.shape[1:])) for part in self._frames]
        return TransitionBuffer(self._spec, frames, self._num_tasks)

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
        self._append(windows, actions.cpu().numpy(), dones, tasks)
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
        for frames, component in zip(self._frames, self._spec.components, strict=True):
            channels = frames.shape[1]
            last += component.frames * channels
            newest = observations[:, last - channels : last].to(frames.device)
            frames.index_copy_(0, slots, newest)
        self._stored += len(observations)
        return numbers

    def _append(
        self, windows: Numbers, actions: Numbers, ends: NDArray[np.bool_], tasks: Numbers
    ) -> None:
        """Append transitions (B, frames + 1), replacing the oldest."""
        rows = np.arange(self._added, self._added + len(windows)) % self._capacity
        self._windows[rows] = windows
        self._labels[rows] = np.stack([actions, ends, tasks], axis=1)
        self._added += len(windows)
        self._rows = []

    def _stacks(self, windows: Numbers) -> Tensor:
        """Observations (B, ...) for the windows (B, frames)."""
        parts = []
        for frames, component in zip(self._frames, self._spec.components, strict=True):
            slots = windows[:, -component.frames :].reshape(-1) % self._capacity
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
