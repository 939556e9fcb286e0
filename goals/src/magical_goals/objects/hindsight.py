"""What a demonstration did, from its recorded frames alone: which block was moved, and where to.

A demonstration is cut into carries: spans in which one block moves, the one nearest to the gripper.
Before and during a carry, the target is its block, and the destination is where that block lay when
the carry ended. After the last carry, the target is the robot, and the destination is where the
robot stopped. So every recorded state gets the goal that was reached from it, as in the relabelling
of Andrychowicz et al., "Hindsight experience replay", NeurIPS 2017.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from magical_goals.objects.parser import ABSENT, MAX_BLOCKS, ParsedFrames
from magical_goals.objects.table import GRIP

ROBOT_TARGET = -1  # instead of a block's number
MOVED = 0.005  # units in a control step: more is motion; still blocks are parsed identically
GLIDE = 0.8  # share of its speed: a block that nothing pushes keeps less in a control step
MIN_CARRY = 0.08  # units: a block that moved less was only touched
OTHER_COLOUR, OTHER_SHAPE = 2.0, 0.05  # units: cost of matching blocks that differ

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


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
    """The goals that were reached from each state of a tracked episode of T steps.

    Args:
        robot: (T + 1, 3) poses.
        blocks: (T + 1, N, 2) positions; absent ones never move.
        intended: (T,), whether the demonstrator's own action was executed: what other actions move
            is not a goal.
        end: the frame in which the demonstrator's last action ended.

    Returns:
        Targets (T,), a block's number or ROBOT_TARGET, and destinations (T, 2).
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
