"""Demonstrations as training data: what was done, found in hindsight in the recorded frames.

A demonstration is cut into carries: spans in which one block moves, the one nearest to the gripper.
Before and during a carry, the target is its block, and the destination is where that block lay when
the carry ended. After the last carry, the target is the robot, and the destination is where the
robot stopped. So every recorded state gets the goal that was reached from it, as in the relabelling
of Andrychowicz et al., "Hindsight experience replay", NeurIPS 2017.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from torch import Tensor

from magical.demos.trajectory import Trajectory, TrajectorySource
from magical.errors import DemonstrationsError
from magical.observe import PRESETS
from magical_baselines.data import Rows, TaskTrajectories
from magical_goals.objects.control import GRIP, ROBOT_TARGET, to_table, to_tensor
from magical_goals.objects.goals import relate_blocks
from magical_goals.objects.parser import ABSENT, MAX_BLOCKS, Floats, Ints, ParsedFrames, Perception

OBSERVATION = "LoRes4A"  # the allocentric camera sees every object
CHUNK = 256  # frames or samples that are processed at a time
STILL, STILL_FINGERS = 0.004, 0.02  # units or rad, rad per step: more is motion

MOVED = 0.005  # units in a control step: more is motion; still blocks are parsed identically
GLIDE = 0.8  # share of its speed: a block that nothing pushes keeps less in a control step
MIN_CARRY = 0.08  # units: a block that moved less was only touched
OTHER_COLOUR, OTHER_SHAPE = 2.0, 0.05  # units: cost of matching blocks that differ


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

    They are `table`; `relations` (S, N, R) of every block where it lies; `targets` (S,) and
    `destinations` (S, 2); `actions` (S,), the trajectories' labels; `tasks` (S,), by position.
    """

    def __init__(
        self,
        demonstrations: Sequence[ParsedDemonstration],
        task_names: Sequence[str],
        device: str = "cpu",
    ) -> None:
        """Find the goals of all steps; those in which a watched policy acted are not sampled."""
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
    ((single, _),) = PRESETS[OBSERVATION].components
    source, steps = TrajectorySource(trajectory), np.arange(len(trajectory) + 1)
    parts = []
    for start in range(0, len(steps), CHUNK):
        frames = single.read(source, steps[start : start + CHUNK])  # (B, 3, 96, 96)
        parts.append(perception(frames.transpose(0, 2, 3, 1)))
    return track(ParsedFrames.joined(parts))


def track(parsed: ParsedFrames) -> ParsedFrames:
    """The same frames with blocks numbered as in the first frame.

    A block that is not found keeps its last position; additional blocks are left out.
    """
    count = int((parsed.colours[0] != ABSENT).sum())
    blocks, colours = parsed.blocks.copy(), np.repeat(parsed.colours[:1], len(parsed.robot), axis=0)
    shapes = np.repeat(parsed.shapes[:1], len(parsed.robot), axis=0)
    blocks[:, count:] = parsed.blocks[0, count:]
    for t in range(1, len(blocks)):
        found = np.flatnonzero(parsed.colours[t] != ABSENT)
        new = parsed.blocks[t, found]
        cost = np.linalg.norm(blocks[t - 1, :count, None] - new[None], axis=2)
        cost += OTHER_COLOUR * (colours[0, :count, None] != parsed.colours[t, found])
        cost += OTHER_SHAPE * (shapes[0, :count, None] != parsed.shapes[t, found])
        rows, columns = linear_sum_assignment(cost)
        blocks[t, :count] = blocks[t - 1, :count]
        for row, column in zip(rows, columns, strict=True):
            if cost[row, column] < OTHER_COLOUR:
                blocks[t, row] = new[column]
    return parsed._replace(blocks=blocks, colours=colours, shapes=shapes)


def find_goals(
    robot: Floats, blocks: Floats, intended: NDArray[np.bool_], end: int
) -> tuple[Ints, Floats]:
    """Targets (T,) and destinations (T, 2): the goals reached from the states of T steps.

    Args:
        robot: (T + 1, 3) poses.
        blocks: (T + 1, N, 2) positions, tracked.
        intended: (T,), whether the demonstrator's own action was executed: others have no goal.
        end: the frame in which the demonstrator's last action ended.
    """
    steps = len(robot) - 1
    targets = np.full(steps, ROBOT_TARGET, np.int64)
    destinations = np.repeat(robot[end : end + 1, :2], steps, axis=0)
    first = 0
    for block, _, last in find_carries(robot, blocks, intended):
        targets[first : last + 1] = block
        destinations[first : last + 1] = blocks[last + 1, block]
        first = last + 1
    return targets, destinations


def find_carries(
    robot: Floats, blocks: Floats, intended: NDArray[np.bool_]
) -> list[tuple[int, int, int]]:
    """The block, first step and last step of each carry, in order."""
    moved = _moved_on_purpose(blocks, intended)
    angle = robot[:-1, 2]
    grip = robot[:-1, :2] + GRIP * np.stack([-np.sin(angle), np.cos(angle)], axis=1)
    far = np.where(moved, np.linalg.norm(blocks[:-1] - grip[:, None], axis=2), np.inf)
    carried = np.where(moved.any(axis=1), far.argmin(axis=1), MAX_BLOCKS)  # MAX_BLOCKS: none
    while True:
        spans = _spans(carried)
        lengths = [np.linalg.norm(blocks[e + 1, b] - blocks[s, b]) for b, s, e in spans]
        if not spans or min(lengths) >= MIN_CARRY:
            return spans
        _, start, end = spans[int(np.argmin(lengths))]
        carried[start : end + 1] = MAX_BLOCKS


def _moved_on_purpose(blocks: Floats, intended: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which blocks (T, N) the demonstrator's own actions move, without those that only glide on.

    A block glides on if another action set it in motion and it has been losing speed since.
    """
    speeds = np.linalg.norm(np.diff(blocks, axis=0), axis=2)  # (T, N)
    moved = speeds > MOVED
    on_purpose: NDArray[np.bool_] = moved & intended[:, None]
    gliding = np.zeros(moved.shape[1], np.bool_)
    before = np.zeros(moved.shape[1])
    for step, own in enumerate(intended):
        if own:
            gliding &= speeds[step] < GLIDE * before
        else:
            gliding |= before <= MOVED
        gliding &= moved[step]
        on_purpose[step] &= ~gliding
        before = speeds[step]
    return on_purpose


def _spans(carried: Ints) -> list[tuple[int, int, int]]:
    """Spans of one block each, which may contain steps in which no block moves."""
    spans: list[tuple[int, int, int]] = []
    for step in np.flatnonzero(carried < MAX_BLOCKS).tolist():
        block, start = int(carried[step]), step
        if spans and spans[-1][0] == block:
            start = spans.pop()[1]
        spans.append((block, start, step))
    return spans
