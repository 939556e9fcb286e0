"""Training data: samples of demonstrations, and replay buffers of what a policy did lately.

Each frame is stored once, as uint8 with channels first, and stacks are assembled when sampled. Ten
demonstrations of a hundred steps take 28 MB this way, and 110 MB as stacks.
"""

import zlib
from collections.abc import Iterable, Mapping, Sequence
from itertools import repeat
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from magical.demos import Dataset, Trajectory
from magical.demos.trajectory import TrajectorySource
from magical.envs.action_spec import Actions, spec_of
from magical.errors import DemonstrationsError, TrajectoryError
from magical.files import sha256_sum
from magical.observe import ObservationSpec, stack_indices
from magical.scene import NOOP
from magical_baselines.augmentation.augment import augment
from magical_baselines.augmentation.names import Augmentations
from magical_baselines.config import DemonstrationConfig
from magical_baselines.training import Purpose, Run, StateDict, stream

Rows = NDArray[np.int64]  # (B,) numbers of samples, frames, tasks
TaskTrajectories = tuple[tuple[str, Trajectory], ...]  # each with the name of its task


def load_demonstrations(config: DemonstrationConfig, run: Run) -> TaskTrajectories:
    """Sample the demonstrations that the configuration asks for, and record them in `run.json`.

    Raises what `sample_demonstrations` and `Run.describe` raise.
    """
    trajectories, record = sample_demonstrations(config)
    run.describe(demonstrations=record)
    return trajectories


def sample_demonstrations(
    config: DemonstrationConfig,
) -> tuple[TaskTrajectories, list[dict[str, Any]]]:
    """Sample demonstrations of each task's Demo variant; the sample depends on the seed alone.

    All algorithms get the same demonstrations for the same seed, and a task in a multi-task run
    gets the same ones as in a single-task run (appendix B).

    Returns:
        The demonstrations with their tasks, and the task, file and SHA-256 of each.

    Raises:
        DemonstrationsError: too few, or continuous actions without a discrete equivalent.
        DatasetError: the dataset is missing or damaged.
    """
    dataset, count = Dataset.open(config.demos), config.num_demos
    trajectories: list[tuple[str, Trajectory]] = []
    record = []
    for task in config.tasks:
        of_task = dataset.filter(task=task, variant="Demo")
        if len(of_task) < count:
            held = sorted({f"{entry.task}-{entry.variant}" for entry in dataset.entries})
            raise DemonstrationsError(
                f"{dataset.path}: expected at least {count} demonstrations of {task} "
                f"(Demo), found {len(of_task)}; the dataset holds: {', '.join(held) or 'nothing'}. "
                "Add demonstrations, or ask for fewer with --num-demos"
            )
        some = of_task.sample(count, stream(config.seed, Purpose.DEMONSTRATIONS))
        try:
            trajectories += [(task, each.with_action_space(config.action_space)) for each in some]
        except TrajectoryError as error:
            raise DemonstrationsError(f"this learner takes discrete actions: {error}") from error
        record += [
            {"task": task, "file": e.file, "sha256": sha256_sum(some.path / e.file)}
            for e in some.entries
        ]
    return tuple(trajectories), record


class ExpertData:
    """The state-action samples of demonstrations, S in all, on a device.

    Attributes:
        actions: (S,) int64, the trajectories' labels; (S, 3) float32 if continuous.
        executed: like `actions`, the executed actions, which differ in perturbed steps.
        is_last: (S,) bool, whether a sample is the last of its trajectory.
        ends: (S,) bool, whether the time limit follows a sample's action.
        tasks: (S,) int64, positions in `task_names`.
        frames: for each component of the observation all frames, (F, ...).
    """

    def __init__(
        self,
        demonstrations: Iterable[tuple[str, Trajectory]],
        task_names: Sequence[str],
        spec: ObservationSpec,
        *,
        device: str = "cpu",
        remove_noops: bool = False,
        transitions: bool = False,
    ) -> None:
        """Read demonstrations, each with the name of its task, one of `task_names`.

        Steps in which a watched policy acted on its own are left out, with `remove_noops` those
        whose action is the no-op, and for `transitions` those whose executed action is not the
        label, as their next observations result from another action. Raises `DemonstrationsError`
        if a task has no samples left.
        """
        names, trajectories = zip(*demonstrations, strict=True)
        self.device, self._spec = device, spec
        kept = [t.is_intended if transitions else t.is_demonstrated.copy() for t in trajectories]
        if remove_noops:
            kept = [some & ~_noops(t.labels) for some, t in zip(kept, trajectories, strict=True)]
        steps = [np.flatnonzero(of_one) for of_one in kept]
        lengths = [len(s) for s in steps]
        self._bounds = _bounds(trajectories, steps)  # (2, S)
        self.is_last = np.isin(np.arange(sum(lengths)), np.cumsum(lengths) - 1)
        ends = [some == len(t) - 1 for t, some in zip(trajectories, steps, strict=True)]
        self.ends = torch.from_numpy(np.concatenate(ends)).to(device)
        first = np.cumsum([0, *(len(t) + 1 for t in trajectories[:-1])])  # each one's first frame
        sources = [TrajectorySource(trajectory) for trajectory in trajectories]
        self.frames: list[Tensor] = []
        for single, _ in spec.components:
            frames = [single.read(source, np.arange(len(source) + 1)) for source in sources]
            self.frames.append(torch.from_numpy(np.concatenate(frames)).to(device))
        parts = map(stack_indices, (s + 1 for s in steps), repeat(spec.frames + 1))
        windows = np.concatenate([n + part for n, part in zip(first, parts, strict=True)])
        # (S, K + 1), numbers of frames, oldest first, the last after the sample's action
        self._windows = torch.from_numpy(windows).to(device)
        labels = [t.labels[some] for t, some in zip(trajectories, steps, strict=True)]
        executed = [t.actions[some] for t, some in zip(trajectories, steps, strict=True)]
        joined = (torch.from_numpy(np.concatenate(parts)) for parts in (labels, executed))
        self.actions, self.executed = (
            (each.float() if each.is_floating_point() else each).to(device) for each in joined
        )
        tasks = np.repeat([task_names.index(name) for name in names], lengths)
        self.tasks = torch.from_numpy(tasks).to(device)
        self._rows = [np.flatnonzero(tasks == number) for number in range(len(task_names))]
        for name, rows in zip(task_names, self._rows, strict=True):
            if not len(rows):
                raise DemonstrationsError(
                    f"{name}: expected demonstrated actions"
                    f"{' other than no-ops' * remove_noops} (those of a watched policy do not "
                    f"count{', nor those that were not executed' * transitions}), found none"
                )

    def __len__(self) -> int:
        return len(self.actions)

    def images(self, rows: Rows, *, following: bool = False) -> Tensor:
        """Frame stacks (B, C, H, W) uint8 of samples, in the observation's channel order.

        State vectors are (B, size) float32. `following`: those after the samples' actions.
        """
        windows = self._windows[self._index(rows)]  # (B, K + 1)
        chosen = windows[:, 1:] if following else windows[:, :-1]
        return stack_frames(self.frames, self._spec, chosen)

    def augmented(
        self, rows: Rows, which: Augmentations, rng: np.random.Generator, together: int = 1
    ) -> Tensor:
        """Augmented frame stacks (B, C, H, W) of samples; see `augment`."""
        return augment(self.images(rows), which, rng, together)

    def neighbours(self, rows: Rows, offsets: Rows) -> tuple[Rows, NDArray[np.bool_]]:
        """Samples at offsets (K,) from the given ones, and whether each exists: both (B, K).

        Offsets count samples of the same trajectory. They are clipped at its ends, and at steps in
        which a policy acted on its own. Positive ones are also clipped after a step whose executed
        action is not the label: the next label is for a state that the label does not lead to.
        """
        wanted = rows[:, None] + offsets
        first, last = self._bounds[:, rows, None]
        found = wanted.clip(first, last)
        return found, found == wanted

    def labels(self, rows: Rows) -> tuple[Tensor, Tensor]:
        """Actions (B,) int64, or (B, 3) float32 if continuous, and tasks (B,) int64."""
        index = self._index(rows)
        return self.actions[index], self.tasks[index]

    def sample(self, size: int, rng: np.random.Generator) -> Rows:
        """Sample rows with replacement: first a task, then one of its samples, both uniformly."""
        numbers = rng.integers(len(self._rows), size=size)
        counts = np.array([len(rows) for rows in self._rows])
        within = rng.integers(counts[numbers])
        return np.array([self._rows[n][i] for n, i in zip(numbers, within, strict=True)], np.int64)

    def sample_counts(self, counts: Sequence[int], rng: np.random.Generator) -> Rows:
        """Sample `counts[k]` rows of task k with replacement, in the order of the tasks."""
        sampled = [rng.choice(rows, n) for rows, n in zip(self._rows, counts, strict=True)]
        return np.concatenate(sampled).astype(np.int64)

    def _index(self, rows: NDArray[Any]) -> Tensor:
        return torch.from_numpy(rows).to(self.actions.device, non_blocking=True)


def _bounds(trajectories: Sequence[Trajectory], steps: Sequence[Rows]) -> Rows:
    """The first and the last neighbour of each sample: (2, S); see `ExpertData.neighbours`."""
    demonstrated = [~each.is_demonstrated for each in trajectories]
    diverted = [np.append(False, ~each.is_intended[:-1]) for each in trajectories]
    found = []
    for breaks in (demonstrated, diverted):
        # The first and the last sample of the stretch without breaks around each sample.
        stretches = [np.cumsum(of_one)[some] for of_one, some in zip(breaks, steps, strict=True)]
        begins = np.concatenate([np.diff(of_one, prepend=-1) > 0 for of_one in stretches])
        sizes = np.diff(np.append(np.flatnonzero(begins), len(begins)))
        ends = np.cumsum(sizes)
        found.append(np.repeat([ends - sizes, ends - 1], sizes, axis=1))
    return np.stack([found[0][0], found[1][1]])


def _noops(actions: Actions) -> NDArray[np.bool_]:
    """Whether each of the actions, (T,) or (T, 3), is the no-op: (T,)."""
    equal = actions == spec_of(actions).convert(np.array([NOOP]))
    noops: NDArray[np.bool_] = equal.reshape(len(actions), -1).all(axis=1)
    return noops


def stack_frames(frames: Sequence[Tensor], spec: ObservationSpec, windows: Tensor) -> Tensor:
    """Observations (B, ...) for windows (B, K) of numbers of frames, the newest last.

    A component of the observation has its own frames, and as many of a window as it shows.
    """
    stacks = []
    for of_one, (_, count) in zip(frames, spec.components, strict=True):
        found = of_one.index_select(0, windows[:, -count:].flatten())
        stacks.append(found.view(len(windows), -1, *of_one.shape[2:]))
    return stacks[0] if len(stacks) == 1 else torch.cat(stacks, dim=1)


def split_evenly(size: int, num_tasks: int, rng: np.random.Generator) -> list[int]:
    """Split `size` samples between tasks: the same number each, and one more for some.

    The tasks that get one more are sampled, so that all have the same expected share.
    """
    share, rest = divmod(size, num_tasks)
    counts = np.full(num_tasks, share)
    if rest:
        counts[rng.choice(num_tasks, rest, replace=False)] += 1
    return [int(count) for count in counts]


class Transitions(NamedTuple):
    """B transitions (s, a, s')."""

    observations: Tensor  # (B, ...), s as a network gets it
    actions: Tensor  # (B,) int64
    next_observations: Tensor  # (B, ...), s': at the end of an episode its final observation
    ends: Tensor  # (B,) bool, whether the time limit ends the episode with s'
    tasks: Tensor  # (B,) int64, positions in the configuration's tasks

    def augmented(self, which: Augmentations, rng: np.random.Generator) -> "Transitions":
        """With augmented images, those of s and of s' independently."""
        before = augment(self.observations, which, rng)
        after = augment(self.next_observations, which, rng)
        return self._replace(observations=before, next_observations=after)


def expert_transitions(
    expert: ExpertData, counts: Sequence[int], rng: np.random.Generator
) -> Transitions:
    """Sample `counts[k]` demonstrated transitions of task k, uniformly with replacement."""
    rows = expert.sample_counts(counts, rng)
    actions, tasks = expert.labels(rows)
    ends = expert.ends[torch.from_numpy(rows).to(expert.device)]
    following = expert.images(rows, following=True)
    return Transitions(expert.images(rows), actions, following, ends, tasks)


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
        self._current: Rows = np.zeros((0, spec.frames), np.int64)  # the environments' stacks
        self._rows: list[Rows] = []  # of each task's transitions

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
        tasks: Rows,
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
    def _by_task(self) -> list[Rows]:
        """The rows of each task's transitions whose frames are all still stored."""
        if not self._rows:
            filled = slice(min(self._added, self._capacity))
            kept = self._windows[filled, 0] >= self._stored - self._capacity
            tasks = self._labels[filled, 2]
            self._rows = [np.flatnonzero(kept & (tasks == k)) for k in range(self._num_tasks)]
        return self._rows

    def _store(self, observations: Tensor) -> Rows:
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

    def _stacks(self, windows: Rows) -> Tensor:
        """Observations (B, ...) for the windows (B, frames)."""
        slots = torch.from_numpy(windows % self._capacity).to(self._frames[0].device)
        return stack_frames(self._frames, self._spec, slots)

    def state_dict(self) -> StateDict:
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

    def __init__(self, task_of: Rows, device: str, capacity: int = 4) -> None:
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
