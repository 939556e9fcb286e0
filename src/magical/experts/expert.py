"""The scripted expert: which move is made now, and the skill that makes it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from magical.experts import steering
from magical.experts.action_noise import ActionNoise
from magical.experts.carry import carry, grip, is_gripped
from magical.experts.distances import DRIVING_CLEARANCE, WORKING_DISTANCE
from magical.experts.goals import get_goals
from magical.experts.grasp import is_between_fingers
from magical.experts.grasp_costs import best_side
from magical.experts.memory import STALL, Memory, note_motion, note_progress
from magical.experts.paths import segment_distance
from magical.experts.planning import Goals, Move, Strategy
from magical.experts.state_view import StateView
from magical.scene import NOOP, State
from magical.scene.actions import Action, Gripper
from magical.scene.geometry import Point

IDLE_ACTION = Action(gripper=Gripper.CLOSED).id  # of a finished expert; see `_idle_action`


@dataclass(frozen=True, slots=True)
class ChoiceSettings:
    """How often decisions are reviewed, and what the next move is chosen by."""

    review_steps: int = 8  # control steps between reviews of a side, or of an empty plan; tuned
    solved_steps: int = 3  # control steps between checks whether the task is solved; for time
    retry_cost: float = 40.0  # control steps for each time that a block's move was given up; tuned
    occupied_cost: float = 60.0  # control steps per unit of missing room around the goal; swept
    blocked_cost: float = 300.0  # control steps per unit of missing room beside the way; swept


@dataclass(frozen=True, slots=True)
class RetrySettings:
    """How a block that could not be grasped is approached again."""

    steps: int = 20  # control steps in which it is knocked loose; tuned
    offset: float = 0.13  # units beside its centre that are aimed at; tuned
    rotation: float = 2.4  # rad between one attempt and the next: the golden angle
    side_shift: int = 5  # attempts that shift the preferences of sides, then again from the first


CHOICE = ChoiceSettings()
RETRY = RetrySettings()


class Expert:
    """A closed-loop demonstrator of one task.

    Its state during an episode is in `Memory`: it can start, or start again, in any state.
    """

    def __init__(self, goals: Goals, strategy: Strategy, noise: ActionNoise | None = None) -> None:
        self._goals = goals
        self._strategy = strategy
        self._noise = noise

    def act(self, state: State, memory: Memory | None = None) -> tuple[int, Memory]:
        """Decide on the next action.

        Args:
            state: The present state, any that the task can be in.
            memory: What the last call returned; None at the start or on taking over.

        Returns:
            The action's id, and the memory for the next call.
        """
        action, memory = self._decide(StateView.from_state(state), memory or Memory())
        if self._noise is not None:
            action = self._noise.perturb_action(action)
        return action, memory

    def _decide(self, view: StateView, memory: Memory) -> tuple[int, Memory]:
        memory = note_motion(view, memory)
        if memory.escape_steps:
            action = steering.escape(memory.failures, memory.escape_with_block)
            return action, replace(memory, escape_steps=memory.escape_steps - 1)
        move = memory.move
        if move is None or _is_done(view, move) or self._is_solved(view, memory):
            if memory.idle_steps and move is None:
                memory = replace(memory, idle_steps=memory.idle_steps - 1, stalled_steps=0)
                return self._idle_action(view), memory
            memory = self._choose_move(view, memory)
            move = memory.move
        if move is None:
            return self._idle_action(view), memory
        return self._pursue(view, move, memory)

    def _idle_action(self, view: StateView) -> int:
        """The action where nothing is left to do.

        Closed fingers that squeeze a block creep on with it, so it is released first. Then a
        finished expert keeps its fingers closed: learners that leave out no-op samples, as the
        paper's behavioural cloning does, could not learn from no-ops to stay where they are.
        """
        if self._goals.unsolvable_fn(view.scene):
            return NOOP
        action = steering.back_off(view, view.blocks)
        return IDLE_ACTION if action is None else action

    def _is_solved(self, view: StateView, memory: Memory) -> bool:
        return memory.move_steps % CHOICE.solved_steps == 0 and self._goals.solved_fn(view)

    def _choose_move(self, view: StateView, memory: Memory) -> Memory:
        """Plan again, and choose the move that takes the fewest control steps."""
        if self._goals.unsolvable_fn(view.scene):
            return replace(memory, move=None, idle_steps=CHOICE.review_steps)
        plan = self._goals.plan_fn(view, self._strategy, memory.plan)
        memory = replace(
            memory, plan=plan, move_steps=0, steps_without_progress=0, nearest=math.inf
        )
        if not plan.moves:
            return replace(memory, move=None, idle_steps=CHOICE.review_steps)
        move = min(plan.moves, key=lambda move: self._cost(view, move, memory))
        if self._noise is None:
            return replace(memory, move=move)
        return replace(
            memory, move=self._noise.perturb_goal(move), escape_steps=self._noise.sample_detour()
        )

    def _cost(self, view: StateView, move: Move, memory: Memory) -> float:
        """About how many control steps a move takes, and how many it is better to wait with it."""
        if move.block is None:
            return 0.0
        preferences = self._strategy.block_costs
        cost = preferences[(move.block + memory.failures) % len(preferences)]
        cost += CHOICE.retry_cost * memory.failed_blocks.count(move.block)
        waiting = [m.block for m in memory.plan.moves if m.block not in (None, move.block)]
        places = [view.blocks[block] for block in waiting if block is not None]
        cost += CHOICE.occupied_cost * _missing_room(move.goal, places)
        cost += CHOICE.blocked_cost * _missing_width(view, view.blocks[move.block], move.goal)
        _, steps = self._best_side(view, move.block, move.goal, memory.failures)
        return cost + steps + move.extra_cost

    def _best_side(
        self,
        view: StateView,
        block: int,
        goal: Point,
        failures: int,
        current: float | None = None,
    ) -> tuple[float, float]:
        shift = failures % RETRY.side_shift
        preferences = self._strategy.side_costs[shift:] + self._strategy.side_costs[:shift]
        others = view.other_blocks(block)
        return best_side(view, view.blocks[block], goal, others, preferences, current)

    def _pursue(self, view: StateView, move: Move, memory: Memory) -> tuple[int, Memory]:
        """The action of the skill that the move needs now."""
        if move.block is None:
            memory = note_progress(_count_step(memory), view.distance_to(move.goal))
            push_aside = memory.steps_without_progress > STALL.push_aside_steps
            return steering.travel(view, move.goal, view.blocks, push_aside), memory
        if is_between_fingers(view, view.blocks[move.block], is_held=memory.held_steps > 0):
            return _carry(view, move, move.block, memory)
        return self._approach(view, move, move.block, memory)

    def _approach(
        self, view: StateView, move: Move, block: int, memory: Memory
    ) -> tuple[int, Memory]:
        centre = view.blocks[block]
        counted = _count_step(memory)
        if memory.move_steps % CHOICE.review_steps == 0:
            current = memory.side if memory.move_steps else None
            side, _ = self._best_side(view, block, move.goal, memory.failures, current)
            nearest = memory.nearest if side == current else math.inf
            counted = replace(counted, side=side, nearest=nearest)
        side = counted.side
        counted = note_progress(counted, steering.remaining_distance(view, centre, side))
        push_aside = counted.steps_without_progress > STALL.push_aside_steps
        if block in memory.failed_blocks and memory.move_steps < RETRY.steps:
            centre = _beside(centre, memory.failures)
        others = view.other_blocks(block)
        return steering.approach(view, centre, side, others, push_aside), counted


def _carry(view: StateView, move: Move, block: int, memory: Memory) -> tuple[int, Memory]:
    centre = view.blocks[block]
    counted = replace(
        _count_step(memory),
        steps_without_progress=0,
        nearest=math.inf,
        held_steps=memory.held_steps + 1,
    )
    if not is_gripped(view, memory.held_steps):
        return grip(view, centre), counted
    return carry(view, centre, move.goal, move.tolerance, view.other_blocks(block)), counted


def _count_step(memory: Memory) -> Memory:
    """Count a control step of a move whose block, if any, is not between the fingers."""
    return replace(
        memory,
        move_steps=memory.move_steps + 1,
        steps_without_progress=memory.steps_without_progress + 1,
        held_steps=0,
    )


def _beside(block: Point, attempt: int) -> Point:
    """A point beside a block to drive at, which knocks it loose; another one each time."""
    angle = RETRY.rotation * attempt
    return block[0] + RETRY.offset * math.cos(angle), block[1] + RETRY.offset * math.sin(angle)


def _missing_width(view: StateView, start: Point, goal: Point) -> float:
    """Units by which blocks narrow the straight way of a block, in all."""
    total = 0.0
    for other in view.blocks:
        distance = segment_distance(start, goal, other)
        if distance < min(DRIVING_CLEARANCE, math.dist(start, other)):
            total += DRIVING_CLEARANCE - distance
    return total


def _missing_room(place: Point, blocks: Sequence[Point]) -> float:
    """Units by which blocks are too near to a place for releasing one there, in all."""
    return sum(max(0.0, WORKING_DISTANCE - math.dist(place, block)) for block in blocks)


def _is_done(view: StateView, move: Move) -> bool:
    place = view.position if move.block is None else view.resting_blocks[move.block]
    if move.area is not None and move.area.contains(*place):
        return True
    return math.dist(place, move.goal) < move.tolerance


def expert_for(
    task: str,
    *,
    seed: int | None = None,
    rng: np.random.Generator | None = None,
    skill: float = 1.0,
) -> Expert:
    """The expert of a task, with a sampled strategy.

    Args:
        task: The task's name, such as MoveToCorner.
        seed: Of the strategy and the action noise; None: a random one.
        rng: What they are sampled from instead, where given.
        skill: From 0 to 1. Below 1 the expert makes mistakes: random actions, detours, and
            sometimes wrong goals.

    Raises:
        NoExpertError: the task has none.
        InvalidConfigError: the skill is not between 0 and 1.
    """
    goals = get_goals(task)
    rng = np.random.default_rng(seed) if rng is None else rng
    strategy = Strategy.sample(rng)
    return Expert(goals, strategy, None if skill == 1.0 else ActionNoise(1.0 - skill, rng))
