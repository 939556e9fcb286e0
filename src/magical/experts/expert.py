"""The scripted expert: from a state to a move, from a move to an action, and what it remembers."""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from magical.experts.carry import carry
from magical.experts.geometry import DRIVING_CLEARANCE, WORKING_DISTANCE, segment_distance
from magical.experts.goals import get_planner
from magical.experts.grasp import (
    approach,
    back_off,
    best_side,
    escape,
    is_between_fingers,
    remaining_distance,
    travel,
)
from magical.experts.planning import Move, MovePlan, Planner, Strategy
from magical.experts.state_view import StateView
from magical.scene import ACTIONS, NOOP, Action, Gripper, Point, State
from magical.tasks import Task, get_task

REVIEW_STEPS = 8  # control steps between reviews of a side, or of an empty plan; tuned
SOLVED_STEPS = 3  # control steps between checks whether the task is solved; for time

# Costs that decide the next move, in addition to the steps that it takes.
RETRY_COST = 40.0  # control steps for each time that a block's move was given up; tuned
OCCUPIED_COST = 60.0  # control steps per unit of missing room around the goal; swept
BLOCKED_COST = 300.0  # control steps per unit of missing room along the way; swept

# How a block that could not be grasped is approached again.
RETRY_STEPS = 20  # control steps in which it is knocked loose; tuned
RETRY_OFFSET = 0.13  # units from its centre to the point to aim at; tuned
RETRY_ROTATION = 2.4  # rad between one attempt and the next: the golden angle
SIDE_SHIFTS = 5  # attempts that shift the side preferences before they repeat

# When the robot is stuck, and what it does then.
STALLED_STEPS = 7  # control steps without motion until the robot is stuck; tuned
MOTION = 0.06  # units that count as motion; tuned
ROTATION = 0.4  # rad that count as motion; tuned
NO_PROGRESS_STEPS = 24  # control steps without progress until it is stuck; tuned
PUSH_ASIDE_STEPS = 12  # of these, the control steps before blocks are pushed aside; tuned
PROGRESS = 0.05  # units of decrease in the distance to drive that count as progress; tuned
MAX_MOVE_STEPS = 80  # control steps of a move in total; tuned
ESCAPE_STEPS = 4  # control steps of driving away from a move that was given up; tuned
KEPT_FAILURES = 3  # number of moves given up last that are kept; tuned

_STRATEGY = 1  # spawn key of strategies; that of the random actions of `rollout` is 0
_CLOSE = Action(gripper=Gripper.CLOSED).id


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


@dataclass(frozen=True, slots=True)
class Expert:
    """A closed-loop demonstrator of one task.

    Its state during an episode is in `Memory`, so it can start, or start again, in any state. If
    the scene does not fit the task, it does nothing.
    """

    task: Task
    planner: Planner
    strategy: Strategy

    def act(self, state: State, memory: Memory | None = None) -> tuple[int, Memory]:
        """Decide on the next action.

        Args:
            state: the current state, which may be any state of the task.
            memory: the memory returned by the last call; None at the start or when taking over.

        Returns:
            The action's id, and the memory for the next call.
        """
        memory = memory or Memory()
        if self.task.problem(state.scene):
            return NOOP, memory
        return self._decide(StateView.from_state(state), memory)

    def _decide(self, view: StateView, memory: Memory) -> tuple[int, Memory]:
        """Escape if the robot is stuck; otherwise choose a move if there is none, and make it."""
        memory = _note_motion(view, memory)
        if memory.escape_steps:
            action = escape(memory.failures, memory.escape_with_block)
            return action, replace(memory, escape_steps=memory.escape_steps - 1)
        move = memory.move
        if move is None and memory.idle_steps:
            memory = replace(memory, idle_steps=memory.idle_steps - 1, stalled_steps=0)
        elif (
            move is None
            or _is_done(view, move)
            or (memory.move_steps % SOLVED_STEPS == 0 and self.planner.solved_fn(view))
        ):
            memory = self._choose_move(view, memory)
        if memory.move is None:
            # Closed fingers that squeeze a block creep on with it, so it is released first. Then a
            # finished expert keeps its fingers closed: learners that leave out no-op samples, as
            # the paper's behavioural cloning does, could not learn to stay in place from no-ops.
            leaving = back_off(view, view.blocks)
            return _CLOSE if leaving is None else leaving, memory
        return self._make_move(view, memory.move, memory)

    def _choose_move(self, view: StateView, memory: Memory) -> Memory:
        """Plan again, and choose the move that takes the fewest control steps."""
        plan = self.planner.plan_fn(view, self.strategy, memory.plan)
        memory = replace(
            memory, plan=plan, move=None, move_steps=0, steps_without_progress=0, nearest=math.inf
        )
        if not plan.moves:
            return replace(memory, idle_steps=REVIEW_STEPS)
        move = min(plan.moves, key=lambda move: self._cost(view, move, memory))
        return replace(memory, move=move)

    def _cost(self, view: StateView, move: Move, memory: Memory) -> float:
        """Approximate control steps that a move takes, plus the costs of making it now."""
        if move.block is None:
            return 0.0
        preferences = self.strategy.block_costs
        cost = preferences[(move.block + memory.failures) % len(preferences)]
        cost += RETRY_COST * memory.failed_blocks.count(move.block)
        waiting = [m.block for m in memory.plan.moves if m.block != move.block]
        room = [math.dist(move.goal, view.blocks[i]) for i in waiting if i is not None]
        # Other blocks that are yet to be moved may be too near to the goal to release one there.
        cost += OCCUPIED_COST * sum(max(0.0, WORKING_DISTANCE - distance) for distance in room)
        cost += BLOCKED_COST * _missing_width(view, view.blocks[move.block], move.goal)
        _, steps = self._best_side(view, move.block, move.goal, memory.failures)
        return cost + steps + move.extra_cost

    def _best_side(
        self, view: StateView, block: int, goal: Point, failures: int, current: float | None = None
    ) -> tuple[float, float]:
        shift = failures % SIDE_SHIFTS
        preferences = self.strategy.side_costs[shift:] + self.strategy.side_costs[:shift]
        others = view.other_blocks(block)
        return best_side(view, view.blocks[block], goal, others, preferences, current)

    def _make_move(self, view: StateView, move: Move, memory: Memory) -> tuple[int, Memory]:
        """Drive to the goal; or approach the block, and once it is grasped, carry it there."""
        if move.block is None:
            memory = _note_driving_step(memory, view.distance_to(move.goal))
            return travel(view, move.goal, view.blocks, memory.pushes_aside), memory
        block, others = view.blocks[move.block], view.other_blocks(move.block)
        if is_between_fingers(view, block, is_held=memory.held_steps > 0):
            action = carry(view, block, move.goal, move.tolerance, others, memory.held_steps)
            return action, _note_held_step(memory)
        if memory.move_steps % REVIEW_STEPS == 0:  # a change of side resets the progress
            current = memory.side if memory.move_steps else None
            side, _ = self._best_side(view, move.block, move.goal, memory.failures, current)
            nearest = memory.nearest if side == current else math.inf
            memory = replace(memory, side=side, nearest=nearest)
        aim = block
        if move.block in memory.failed_blocks and memory.move_steps < RETRY_STEPS:
            # A point next to the block, different for each attempt, to knock it loose.
            angle = RETRY_ROTATION * memory.failures
            aim = (
                block[0] + RETRY_OFFSET * math.cos(angle),
                block[1] + RETRY_OFFSET * math.sin(angle),
            )
        memory = _note_driving_step(memory, remaining_distance(view, block, memory.side))
        return approach(view, aim, memory.side, others, memory.pushes_aside), memory


def _is_done(view: StateView, move: Move) -> bool:
    place = view.position if move.block is None else view.resting_blocks[move.block]
    if move.area is not None and move.area.contains(*place):
        return True
    return math.dist(place, move.goal) < move.tolerance


def _missing_width(view: StateView, start: Point, goal: Point) -> float:
    """Total of the units by which other blocks narrow the straight way of a block."""
    total = 0.0
    for other in view.blocks:
        distance = segment_distance(start, goal, other)
        if distance < min(DRIVING_CLEARANCE, math.dist(start, other)):
            total += DRIVING_CLEARANCE - distance
    return total


def note_other_action(memory: Memory, action: int) -> Memory:
    """Record that an action other than the expert's was executed; it takes over from there.

    It keeps its plan, its move and a block that closed fingers hold. Its counts of progress are
    reset: they apply to its own actions only, and could trigger an escape.
    """
    is_closed = ACTIONS[action].gripper is Gripper.CLOSED
    held_steps = memory.held_steps if is_closed else 0
    return Memory(plan=memory.plan, move=memory.move, held_steps=held_steps)


def _note_held_step(memory: Memory) -> Memory:
    """Record a control step of a move with the block between the fingers."""
    return replace(
        memory,
        move_steps=memory.move_steps + 1,
        held_steps=memory.held_steps + 1,
        nearest=math.inf,
        steps_without_progress=0,
    )


def _note_driving_step(memory: Memory, distance: float) -> Memory:
    """Record a control step of a move without a block, at a distance (units) left to drive."""
    is_progress = distance < memory.nearest - PROGRESS
    return replace(
        memory,
        move_steps=memory.move_steps + 1,
        held_steps=0,
        nearest=distance if is_progress else memory.nearest,
        steps_without_progress=0 if is_progress else memory.steps_without_progress + 1,
    )


def _note_motion(view: StateView, memory: Memory) -> Memory:
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


class EpisodeExpert:
    """An expert with its memory of one episode, in which others may also act."""

    def __init__(self, expert: Expert) -> None:
        self._expert = expert
        self._memory = Memory()
        self._action = NOOP  # its last action

    def act(self, state: State) -> int:
        """The expert's action in the current state."""
        self._action, self._memory = self._expert.act(state, self._memory)
        return self._action

    def note_executed(self, action: int) -> None:
        """Record the executed action; if it was not the expert's own, the expert takes over."""
        if action != self._action:
            self._memory = note_other_action(self._memory, action)


def strategy_seed(variant: str, seed: int | None) -> np.random.SeedSequence:
    """The seed of the strategy in the episode of a variant that `reset(seed=seed)` starts.

    With the scene's own random numbers, a demonstrator's preferences would be a function of the
    scene. Demo's scene takes none, so there the seed itself serves, as it did for demonstrations
    that are stored.
    """
    return np.random.SeedSequence(seed, spawn_key=() if variant == "Demo" else (_STRATEGY,))


def expert_for(
    task: str, *, seed: int | np.random.SeedSequence | np.random.Generator | None = None
) -> Expert:
    """The expert of a task, with a sampled strategy.

    Args:
        task: the task's name, such as MoveToCorner.
        seed: seed of the strategy, or the generator to sample it from; None: random. For the
            demonstrator of an episode, `strategy_seed`, not the seed that the scene is sampled
            with.

    Raises:
        UnknownNameError: there is no such task.
        NoExpertError: the task has no expert.
    """
    strategy = Strategy.sample(np.random.default_rng(seed))
    return Expert(get_task(task), get_planner(task), strategy)
