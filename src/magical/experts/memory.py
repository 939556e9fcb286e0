"""An expert's state between decisions, and how it detects that it is stuck."""

import math
from dataclasses import dataclass, field, replace

from magical.experts.planning import Move, MovePlan
from magical.experts.state_view import StateView
from magical.scene.actions import ACTIONS, Gripper

STALLED_STEPS = 7  # control steps without motion until the robot is stuck; tuned
MOTION = 0.06  # units that count as motion; tuned
ROTATION = 0.4  # rad that count as motion; tuned
NO_PROGRESS_STEPS = 24  # control steps without progress until it is stuck; tuned
PUSH_ASIDE_STEPS = 12  # of these, the control steps before blocks are pushed aside; tuned
PROGRESS = 0.05  # units of decrease in the distance to drive that count as progress; tuned
MAX_MOVE_STEPS = 80  # control steps of a move in total; tuned
ESCAPE_STEPS = 4  # control steps of driving away from a move that was given up; tuned
KEPT_FAILURES = 3  # number of moves given up last that are kept; tuned


@dataclass(frozen=True, slots=True)
class Memory:
    """An expert's memory; the defaults are those of an expert that has just taken over."""

    plan: MovePlan = field(default_factory=MovePlan)
    move: Move | None = None
    side: float = 0.0  # rad: bearing at which the block is to be grasped
    move_steps: int = 0  # control steps spent on the move
    held_steps: int = 0  # control steps for which the block has been between the fingers
    nearest: float = math.inf  # units: least distance left to drive during this move
    steps_without_progress: int = 0  # control steps since `nearest` decreased
    stall_pose: tuple[float, float, float] = (math.inf, math.inf, 0.0)  # robot's, when last moving
    stalled_steps: int = 0  # control steps since then
    failures: int = 0  # moves given up
    failed_blocks: tuple[int, ...] = ()  # blocks of the moves given up last
    escape_steps: int = 0  # remaining control steps of driving away
    escape_with_block: bool = False  # whether the fingers stay closed while escaping
    idle_steps: int = 0  # control steps until an idle expert plans again

    @property
    def pushes_aside(self) -> bool:
        """Whether the robot now pushes blocks aside rather than backing off."""
        return self.steps_without_progress > PUSH_ASIDE_STEPS


def note_other_action(memory: Memory, action: int) -> Memory:
    """Record that an action other than the expert's was executed; it takes over from there.

    It keeps its plan, its move and a block that closed fingers hold. Its counts of progress are
    reset: they apply to its own actions only, and could trigger an escape.
    """
    is_closed = ACTIONS[action].gripper is Gripper.CLOSED
    held_steps = memory.held_steps if is_closed else 0
    return Memory(plan=memory.plan, move=memory.move, held_steps=held_steps)


def note_held_step(memory: Memory) -> Memory:
    """Record a control step of a move with the block between the fingers."""
    return replace(
        memory,
        move_steps=memory.move_steps + 1,
        held_steps=memory.held_steps + 1,
        nearest=math.inf,
        steps_without_progress=0,
    )


def note_driving_step(memory: Memory, distance: float) -> Memory:
    """Record a control step of a move without a block, at a distance (units) left to drive."""
    is_progress = distance < memory.nearest - PROGRESS
    return replace(
        memory,
        move_steps=memory.move_steps + 1,
        held_steps=0,
        nearest=distance if is_progress else memory.nearest,
        steps_without_progress=0 if is_progress else memory.steps_without_progress + 1,
    )


def note_motion(view: StateView, memory: Memory) -> Memory:
    """Record whether the robot moves; if it is stuck, give up the move and begin an escape."""
    is_stuck = (
        memory.steps_without_progress > NO_PROGRESS_STEPS or memory.move_steps > MAX_MOVE_STEPS
    )
    x, y, angle = memory.stall_pose
    if view.distance_to((x, y)) > MOTION or abs(angle - view.angle) > ROTATION:
        memory = replace(memory, stall_pose=(view.x, view.y, view.angle), stalled_steps=0)
    elif memory.stalled_steps < STALLED_STEPS:
        memory = replace(memory, stalled_steps=memory.stalled_steps + 1)
    else:
        is_stuck = True
    return _give_up(memory) if is_stuck and not memory.escape_steps else memory


def _give_up(memory: Memory) -> Memory:
    """Give up the move; the next escape pulls a held block along, but not twice in a row."""
    move = memory.move
    failed = () if move is None or move.block is None else (move.block,)
    return Memory(
        plan=memory.plan,
        side=memory.side,
        held_steps=memory.held_steps,
        stall_pose=memory.stall_pose,
        failures=memory.failures + 1,
        failed_blocks=(*failed, *memory.failed_blocks)[:KEPT_FAILURES],
        escape_steps=ESCAPE_STEPS,
        escape_with_block=memory.held_steps > 0 and not memory.escape_with_block,
    )
