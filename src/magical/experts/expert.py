"""The scripted expert: from a state to a move, and from a move to an action."""

import math
from dataclasses import dataclass, replace

import numpy as np

from magical.experts.carry import carry
from magical.experts.geometry import DRIVING_CLEARANCE, WORKING_DISTANCE, segment_distance
from magical.experts.goals import get_planner
from magical.experts.grasp import best_side, is_between_fingers
from magical.experts.memory import Memory, note_driving_step, note_held_step, note_motion
from magical.experts.planning import Move, Planner, Strategy
from magical.experts.state_view import StateView
from magical.experts.steering import approach, back_off, escape, remaining_distance, travel
from magical.scene import NOOP, State
from magical.scene.actions import Action, Gripper
from magical.scene.geometry import Point
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

# Spawn key of strategies; that of the random actions of `rollout` is 0.
_STRATEGY = 1

IDLE_ACTION = Action(gripper=Gripper.CLOSED).id  # of a finished expert; see `_idle_action`


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
        memory = note_motion(view, memory)
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
            return _idle_action(view), memory
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
            memory = note_driving_step(memory, view.distance_to(move.goal))
            return travel(view, move.goal, view.blocks, memory.pushes_aside), memory
        block, others = view.blocks[move.block], view.other_blocks(move.block)
        if is_between_fingers(view, block, is_held=memory.held_steps > 0):
            action = carry(view, block, move.goal, move.tolerance, others, memory.held_steps)
            return action, note_held_step(memory)
        if memory.move_steps % REVIEW_STEPS == 0:
            memory = self._review_side(view, move.block, move.goal, memory)
        aim = block
        if move.block in memory.failed_blocks and memory.move_steps < RETRY_STEPS:
            aim = _beside(block, memory.failures)
        memory = note_driving_step(memory, remaining_distance(view, block, memory.side))
        return approach(view, aim, memory.side, others, memory.pushes_aside), memory

    def _review_side(self, view: StateView, block: int, goal: Point, memory: Memory) -> Memory:
        """Choose the side to grasp the block from; a change of side resets the progress."""
        current = memory.side if memory.move_steps else None
        side, _ = self._best_side(view, block, goal, memory.failures, current)
        return replace(memory, side=side, nearest=memory.nearest if side == current else math.inf)


def _idle_action(view: StateView) -> int:
    """The action when nothing is left to do.

    Closed fingers that squeeze a block creep on with it, so it is released first. Then a finished
    expert keeps its fingers closed: learners that leave out no-op samples, as the paper's
    behavioural cloning does, could not learn to stay in place from no-ops.
    """
    action = back_off(view, view.blocks)
    return IDLE_ACTION if action is None else action


def _is_done(view: StateView, move: Move) -> bool:
    place = view.position if move.block is None else view.resting_blocks[move.block]
    if move.area is not None and move.area.contains(*place):
        return True
    return math.dist(place, move.goal) < move.tolerance


def _beside(block: Point, attempt: int) -> Point:
    """A point next to a block to drive at to knock it loose, different for each attempt."""
    angle = RETRY_ROTATION * attempt
    return block[0] + RETRY_OFFSET * math.cos(angle), block[1] + RETRY_OFFSET * math.sin(angle)


def _missing_width(view: StateView, start: Point, goal: Point) -> float:
    """Total of the units by which other blocks narrow the straight way of a block."""
    total = 0.0
    for other in view.blocks:
        distance = segment_distance(start, goal, other)
        if distance < min(DRIVING_CLEARANCE, math.dist(start, other)):
            total += DRIVING_CLEARANCE - distance
    return total


def strategy_seed(variant: str, seed: int | None) -> np.random.SeedSequence:
    """The seed of the strategy in the episode of a variant that `reset(seed=seed)` starts.

    With the scene's own random numbers, a demonstrator's preferences would be a function of the
    scene. Demo's scene takes none, so there the seed itself serves, as it did for demonstrations
    that are stored.
    """
    return np.random.SeedSequence(seed, spawn_key=() if variant == "Demo" else (_STRATEGY,))


def expert_for(
    task: str,
    *,
    seed: int | np.random.SeedSequence | None = None,
    rng: np.random.Generator | None = None,
) -> Expert:
    """The expert of a task, with a sampled strategy.

    Args:
        task: the task's name, such as MoveToCorner.
        seed: seed of the strategy; None: random. For the demonstrator of an episode,
            `strategy_seed`, not the seed that the scene is sampled with.
        rng: generator from which to sample it instead, if given.

    Raises:
        UnknownNameError: there is no such task.
        NoExpertError: the task has no expert.
    """
    spec, planner = get_task(task), get_planner(task)
    rng = np.random.default_rng(seed) if rng is None else rng
    return Expert(spec, planner, Strategy.sample(rng))
