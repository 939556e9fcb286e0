"""Demonstrations as training data for the object-centred learners."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from magical.demos.store.reader import TrajectorySource
from magical.demos.store.trajectory import Trajectory
from magical.errors import DemonstrationsError
from magical.observe import PRESETS
from magical_baselines.data import Rows, TaskTrajectories
from magical_goals.objects.goals import relate_blocks
from magical_goals.objects.hindsight import ROBOT_TARGET, find_carries, find_goals, track
from magical_goals.objects.parser import ParsedFrames
from magical_goals.objects.perception import Perception
from magical_goals.objects.table import to_table, to_tensor

OBSERVATION = "LoRes4A"  # the allocentric camera sees every object
CHUNK = 256  # frames or samples that are processed at a time
STILL, STILL_FINGERS = 0.004, 0.02  # units or rad, rad per step: more is motion


class ParsedDemonstration(NamedTuple):
    """A demonstration, and the objects in its frames."""

    task: str
    trajectory: Trajectory  # of T steps
    parsed: ParsedFrames  # T + 1 frames, tracked

    @property
    def carries(self) -> list[tuple[int, int, int]]:
        """See `find_carries`."""
        return find_carries(self.parsed.robot, self.parsed.blocks, self.trajectory.is_intended)

    @property
    def end(self) -> int:
        """The frame in which the demonstrator's last action ended."""
        return int(np.flatnonzero(self.trajectory.is_demonstrated)[-1]) + 1


class ObjectData:
    """The S samples of demonstrations: parsed scenes, goals found in hindsight, actions.

    Attributes:
        table: S scenes.
        relations: (S, N, R), of every block where it lies.
        targets: (S,) int64.
        destinations: (S, 2) float32.
        actions: (S,) int64, the trajectories' labels.
        tasks: (S,) int64, positions in the names of tasks.
    """

    def __init__(
        self,
        demonstrations: Sequence[ParsedDemonstration],
        task_names: Sequence[str],
        device: str = "cpu",
    ) -> None:
        """Find the goals of all steps.

        Steps in which a watched policy acted on its own are never sampled.
        """
        trajectories = [each.trajectory for each in demonstrations]
        parsed = ParsedFrames.joined(each.parsed.select(slice(-1)) for each in demonstrations)
        goals = [
            find_goals(each.parsed.robot, each.parsed.blocks, each.trajectory.is_intended, each.end)
            for each in demonstrations
        ]
        targets, destinations = map(np.concatenate, zip(*goals, strict=True))
        actions = np.concatenate([each.labels for each in trajectories])
        of_each = [task_names.index(each.task) for each in demonstrations]
        tasks = np.repeat(of_each, list(map(len, trajectories)))
        demonstrated = np.concatenate([each.is_demonstrated for each in trajectories])
        moves = np.concatenate([_moves(each.parsed) for each in demonstrations])
        self.table = to_table(parsed, device)
        self.targets, self.destinations, self.actions, self.tasks = (
            to_tensor(column).to(device) for column in (targets, destinations, actions, tasks)
        )
        starts = range(0, len(self.actions), CHUNK)
        chunks = [relate_blocks(self.table.select(slice(k, k + CHUNK))) for k in starts]
        self.relations = torch.cat(chunks)
        self._rows = [np.flatnonzero((tasks == k) & demonstrated) for k in range(len(task_names))]
        self._eventful = np.flatnonzero((moves | (targets == ROBOT_TARGET)) & demonstrated)

    def sample_eventful(self, size: int, rng: np.random.Generator) -> Tensor:
        """Sample rows with replacement, except idle ones with a block as the target.

        A memoryless policy that clones idling may idle forever, since its input does not change.
        """
        return self._index(rng.choice(self._eventful, size))

    def sample_each(self, size: int, rng: np.random.Generator) -> Tensor:
        """Sample `size` rows of each task with replacement."""
        return self._index(np.concatenate([rng.choice(rows, size) for rows in self._rows]))

    def _index(self, rows: Rows) -> Tensor:
        return torch.from_numpy(rows).to(self.actions.device)


def _moves(parsed: ParsedFrames) -> NDArray[np.bool_]:
    """Whether the robot, a finger or a block moves in each step, (T,)."""
    robot = np.abs(np.diff(parsed.robot, axis=0)).max(axis=1) > STILL
    fingers = np.abs(np.diff(parsed.fingers, axis=0)).max(axis=1) > STILL_FINGERS
    blocks = np.abs(np.diff(parsed.blocks, axis=0)).max(axis=(1, 2)) > STILL
    moves: NDArray[np.bool_] = robot | fingers | blocks
    return moves


def parse_demonstrations(
    demonstrations: TaskTrajectories, perception: Perception
) -> list[ParsedDemonstration]:
    """Find the objects in all frames, except where a watched policy acted in all steps.

    Raises:
        DemonstrationsError: no demonstrations of a task are left.
    """
    kept = [(task, each) for task, each in demonstrations if each.is_demonstrated.any()]
    for task in {task for task, _ in demonstrations} - {task for task, _ in kept}:
        raise DemonstrationsError(
            f"{task}: expected steps that were demonstrated, found only those of a watched policy"
        )
    return [
        ParsedDemonstration(task, each, parse_trajectory(each, perception)) for task, each in kept
    ]


def parse_trajectory(trajectory: Trajectory, perception: Perception) -> ParsedFrames:
    """The objects in all frames, with blocks numbered as in the first."""
    (component,) = PRESETS[OBSERVATION].components
    source, steps = TrajectorySource(trajectory), np.arange(len(trajectory) + 1)
    parts = []
    for start in range(0, len(steps), CHUNK):
        frames = component.read(source, steps[start : start + CHUNK])  # (B, 3, 96, 96)
        parts.append(perception(frames.transpose(0, 2, 3, 1)))
    return track(ParsedFrames.joined(parts))
