"""Demonstrations as training data: choosing them, and sampling frame stacks and actions.

Each frame is stored once, as uint8 with channels first, and stacks are assembled when sampled. Ten
demonstrations of a hundred steps take 28 MB this way, and 110 MB as stacks.
"""

from collections.abc import Iterable, Sequence
from itertools import repeat
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from magical.demos import Dataset, Trajectory
from magical.demos.reader import TrajectorySource
from magical.envs.action_spec import Actions, ActionSpaceName, spec_of
from magical.errors import DemonstrationsError, TrajectoryError
from magical.observe import ObservationSpec
from magical.observe.spec import stack_indices
from magical.scene import NOOP
from magical_baselines.augmentation.augment import augment
from magical_baselines.augmentation.names import Augmentations
from magical_baselines.config import DemonstrationConfig
from magical_baselines.training import Purpose, Run, stream

Rows = NDArray[np.int64]  # (B,) indices of samples
TaskTrajectories = tuple[tuple[str, Trajectory], ...]  # each with the name of its task


class Demonstrations(NamedTuple):
    """A run's demonstrations, and what identifies them."""

    trajectories: TaskTrajectories
    record: tuple[dict[str, Any], ...]  # task, file and SHA-256 of each


def load_demonstrations(config: DemonstrationConfig, run: Run) -> TaskTrajectories:
    """Sample the demonstrations that the configuration asks for, and record them in `run.json`.

    Raises what `sample_demonstrations` and `Run.describe` raise.
    """
    found = sample_demonstrations(
        config.demos, config.tasks, config.num_demos, config.seed, config.action_space
    )
    run.describe(demonstrations=list(found.record))
    return found.trajectories


def sample_demonstrations(
    path: str,
    tasks: Sequence[str],
    count: int,
    seed: int,
    action_space: ActionSpaceName = "discrete",
) -> Demonstrations:
    """Sample demonstrations of each task's Demo variant; the sample depends on the seed alone.

    All algorithms get the same demonstrations for the same seed, and a task in a multi-task run
    gets the same ones as in a single-task run (appendix B).

    Args:
        path: the dataset's folder.
        tasks: the tasks' names, with `count` demonstrations of each.
        count: see `tasks`.
        seed: the run's seed.
        action_space: the action space that their actions are converted to.

    Raises:
        DemonstrationsError: too few, or continuous actions without a discrete equivalent.
        DatasetError: the dataset is missing or damaged.
    """
    dataset = Dataset.open(path)
    trajectories, record = [], []
    for task in tasks:
        of_task = dataset.filter(task=task, variant="Demo")
        if len(of_task) < count:
            held = sorted({f"{entry.task}-{entry.variant}" for entry in dataset.entries})
            raise DemonstrationsError(
                f"{dataset.path}: expected at least {count} demonstrations of {task} "
                f"(Demo), found {len(of_task)}; the dataset holds: {', '.join(held) or 'nothing'}. "
                "Add demonstrations, or ask for fewer with --num-demos"
            )
        some = of_task.sample(count, stream(seed, Purpose.DEMONSTRATIONS))
        trajectories += [(task, _converted(trajectory, action_space)) for trajectory in some]
        record += [{"task": task, "file": e.file, "sha256": some.sha256(e)} for e in some.entries]
    return Demonstrations(tuple(trajectories), tuple(record))


def _converted(trajectory: Trajectory, action_space: ActionSpaceName) -> Trajectory:
    try:
        return trajectory.with_action_space(action_space)
    except TrajectoryError as error:
        raise DemonstrationsError(f"this learner takes discrete actions: {error}") from error


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
        self.device = device
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
        self._stacks = []  # for each component: (S, frames + 1), indices of frames, oldest first
        for single, count in spec.components:
            frames = [single.read(source, np.arange(len(source) + 1)) for source in sources]
            self.frames.append(torch.from_numpy(np.concatenate(frames)).to(device))
            parts = map(stack_indices, (s + 1 for s in steps), repeat(count + 1))
            stacks = np.concatenate([n + part for n, part in zip(first, parts, strict=True)])
            self._stacks.append(torch.from_numpy(stacks).to(device))
        labels = [t.labels[some] for t, some in zip(trajectories, steps, strict=True)]
        executed = [t.actions[some] for t, some in zip(trajectories, steps, strict=True)]
        self.actions, self.executed = (_to_tensor(parts).to(device) for parts in (labels, executed))
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
        """The number of samples."""
        return len(self.actions)

    def images(self, rows: Rows, *, following: bool = False) -> Tensor:
        """Frame stacks (B, C, H, W) uint8 of samples, in the observation's channel order.

        State vectors are (B, size) float32. `following`: those after the samples' actions.
        """
        index, stacks = self._index(rows), []
        for frames, indices in zip(self.frames, self._stacks, strict=True):
            windows = indices[index]  # (B, K + 1)
            chosen = windows[:, 1:] if following else windows[:, :-1]
            found = frames.index_select(0, chosen.flatten())
            stacks.append(found.view(len(rows), -1, *frames.shape[2:]))
        return stacks[0] if len(stacks) == 1 else torch.cat(stacks, dim=1)

    def augmented(
        self, rows: Rows, which: Augmentations, rng: np.random.Generator, together: int = 1
    ) -> Tensor:
        """Augmented frame stacks of samples: (B, C, H, W) float32 in [0, 1].

        Every `together` consecutive ones share augmentation parameters.
        """
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
    return np.stack([_extents(demonstrated, steps)[0], _extents(diverted, steps)[1]])


def _extents(breaks: Sequence[NDArray[np.bool_]], steps: Sequence[Rows]) -> Rows:
    """The first and the last sample, (2, S), of the stretch without breaks around each sample."""
    stretches = [np.cumsum(of_one)[some] for of_one, some in zip(breaks, steps, strict=True)]
    begins = np.concatenate([np.diff(of_one, prepend=-1) > 0 for of_one in stretches])
    sizes = np.diff(np.append(np.flatnonzero(begins), len(begins)))
    ends = np.cumsum(sizes)
    return np.repeat([ends - sizes, ends - 1], sizes, axis=1)


def _to_tensor(actions: Sequence[Actions]) -> Tensor:
    """Actions of all trajectories, as int64, or float32 if continuous."""
    joined = np.concatenate(actions)
    return torch.from_numpy(joined if joined.dtype == np.int64 else joined.astype(np.float32))


def _noops(actions: Actions) -> NDArray[np.bool_]:
    """Whether each of the actions, (T,) or (T, 3), is the no-op: (T,)."""
    equal = actions == spec_of(actions).convert(np.array([NOOP]))
    noops: NDArray[np.bool_] = equal.reshape(len(actions), -1).all(axis=1)
    return noops


def split_evenly(size: int, num_tasks: int, rng: np.random.Generator) -> list[int]:
    """Split `size` samples between tasks: the same number each, and one more for some.

    The tasks that get one more are sampled, so that all have the same expected share.
    """
    share, rest = divmod(size, num_tasks)
    counts = np.full(num_tasks, share)
    if rest:
        counts[rng.choice(num_tasks, rest, replace=False)] += 1
    return [int(count) for count in counts]
