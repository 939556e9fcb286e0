"""The scripted expert: which move now, and the skill that makes it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from magical.experts import grasp, steering
from magical.experts.carry import carry, grip
from magical.experts.clumsiness import Clumsiness
from magical.experts.goals import NO_PLAN, Goals, Move, Plan, Style, goals_of
from magical.experts.paths import gap
from magical.experts.sight import Sight
from magical.scene import NOOP, State
from magical.scene.actions import Action, Gripper, Longitudinal, Turn
from magical.scene.geometry import Point

PATIENCE = 7  # control steps without progress after which the expert tries something else
RELUCTANCE = 40.0  # control steps that a block whose move was just given up seems further away
ROOM = 0.4  # units around a place that should be free of blocks that are to go elsewhere
TAKEN = 60.0  # control steps, per unit, that a move waits for them to go
WAY = 0.34  # units beside a block's way that should be free
BLOCKED = 300.0  # control steps, per unit, that a move waits for its way to become free
ESCAPE = 4  # control steps that it then drives away
REVIEW = 8  # control steps after which the side of approach is thought over
CHECK = 3  # control steps between looks, on the way, whether the task is solved already
CLOSING = 2  # control steps that closing the fingers takes
GRIPPED = 0.33  # rad: fingers opened less than this have something, or are closing, already
CAREFUL = 12  # control steps without progress after which others may be pushed aside
SEARCH = 24  # control steps without progress after which a move is given up
POKE = 20  # control steps in which a block that could not be grasped is knocked loose first
ASIDE = 0.13  # units beside its centre that are aimed at
HOLD = Action(gripper=Gripper.CLOSED).id  # what a finished expert does
HAUL = 80  # control steps after which a move is given up


FAR = 9.0  # units
PROGRESS = 0.05  # units that count as getting nearer


@dataclass(frozen=True, slots=True)
class Memory:
    """What an expert carries from one decision to the next; it can start from nothing."""

    plan: Plan = NO_PLAN
    move: Move | None = None
    side: float = 0.0  # bearing from which the block is to be grasped, rad
    age: int = 0  # control steps spent on the move
    failures: int = 0  # times it got stuck
    escape: int = 0  # control steps of driving away that are left
    rest: int = 0  # control steps until an idle expert looks again
    mark: tuple[float, float, float] = (9.0, 9.0, 0.0)  # robot's pose when it last got somewhere
    still: int = 0  # control steps since then
    loose: int = 0  # control steps without getting nearer to having the block
    nearest: float = FAR  # units: how near it got
    held: int = 0  # control steps that the block has been between the fingers
    pull: bool = False  # whether the escape keeps the block
    avoid: tuple[int, ...] = ()  # blocks whose moves were given up last


class Expert:
    """A closed-loop demonstrator of one task."""

    def __init__(self, goals: Goals, style: Style, clumsiness: Clumsiness | None = None) -> None:
        self._goals = goals
        self._style = style
        self._clumsiness = clumsiness

    def act(self, state: State, memory: Memory | None = None) -> tuple[int, Memory]:
        """The action for the present state, and the memory for the next call."""
        action, memory = self._decide(Sight.of(state), memory or Memory())
        if self._clumsiness is not None:
            action = self._clumsiness.disturb(action)
        return action, memory

    def _decide(self, sight: Sight, memory: Memory) -> tuple[int, Memory]:
        memory = _watch(sight, memory)
        if memory.escape:
            return _escape(memory), replace(memory, escape=memory.escape - 1)
        move = memory.move
        if move is None or _is_done(sight, move) or self._is_solved(sight, memory):
            if memory.rest and move is None:
                return self._rest(sight), replace(memory, rest=memory.rest - 1, still=0)
            memory = self._choose(sight, memory)
            move = memory.move
            if move is None:
                return self._rest(sight), memory
        return self._pursue(sight, move, memory)

    def _rest(self, sight: Sight) -> int:
        """What to do when nothing is left to do.

        Closed fingers that squeeze a block creep on with it, so it is let go first. Then a
        finished expert holds them closed: learners that leave no-op samples out, as the
        appendix's behavioural cloning does, could not learn from no-ops that staying is right.
        """
        if self._goals.unsolvable(sight.scene):
            return NOOP
        away = steering.leave(sight, sight.blocks)
        return HOLD if away is None else away

    def _is_solved(self, sight: Sight, memory: Memory) -> bool:
        return memory.age % CHECK == 0 and self._goals.solved(sight)

    def _choose(self, sight: Sight, memory: Memory) -> Memory:
        if self._goals.unsolvable(sight.scene):
            return replace(memory, move=None, rest=REVIEW)
        plan = self._goals.plan(sight, self._style, memory.plan)
        memory = replace(memory, plan=plan, age=0, loose=0, nearest=FAR)
        if not plan.moves:
            return replace(memory, move=None, rest=REVIEW)
        move = min(plan.moves, key=lambda move: self._price(sight, move, memory))
        if self._clumsiness is None:
            return replace(memory, move=move)
        return replace(
            memory, move=self._clumsiness.mislead(move), escape=self._clumsiness.detour()
        )

    def _price(self, sight: Sight, move: Move, memory: Memory) -> float:
        if move.block is None:
            return 0.0
        taste = self._style.order[(move.block + memory.failures) % len(self._style.order)]
        again = RELUCTANCE * memory.avoid.count(move.block)
        waiting = [m.block for m in memory.plan.moves if m.block not in (None, move.block)]
        again += TAKEN * _shortage(move.goal, [sight.blocks[i] for i in waiting if i is not None])
        again += BLOCKED * _blockage(sight, sight.blocks[move.block], move.goal)
        side = self._side(sight, move.block, move.goal, memory.failures)
        return side[1] + taste + move.weight + again

    def _side(
        self, sight: Sight, block: int, goal: Point, failures: int, used: float | None = None
    ) -> tuple[float, float]:
        taste = self._style.sides[failures % 5 :] + self._style.sides[: failures % 5]
        others = without(sight.blocks, block)
        return grasp.best_side(sight, sight.blocks[block], goal, others, taste, used)

    def _pursue(self, sight: Sight, move: Move, memory: Memory) -> tuple[int, Memory]:
        aged = replace(memory, age=memory.age + 1, loose=memory.loose + 1, held=0)
        if move.block is None:
            aged = _progress(aged, sight.distance(move.goal))
            return steering.travel(sight, move.goal, sight.blocks, aged.loose > CAREFUL), aged
        block, others = sight.blocks[move.block], without(sight.blocks, move.block)
        if grasp.in_jaw(sight, block, memory.held):
            aged = replace(aged, loose=0, nearest=FAR, held=memory.held + 1)
            if memory.held < CLOSING and sight.opening > GRIPPED:
                return grip(sight, block), aged
            return carry(sight, block, move.goal, move.tolerance, others), aged
        if memory.age % REVIEW == 0:
            used = memory.side if memory.age else None
            side = self._side(sight, move.block, move.goal, memory.failures, used)[0]
            aged = replace(aged, side=side, nearest=aged.nearest if side == used else FAR)
        aged = _progress(aged, steering.remaining(sight, block, aged.side))
        bold = aged.loose > CAREFUL
        if move.block in memory.avoid and memory.age < POKE:
            angle = 2.4 * memory.failures  # the golden angle: another side each time
            block = block[0] + ASIDE * math.cos(angle), block[1] + ASIDE * math.sin(angle)
        return steering.approach(sight, block, aged.side, others, bold), aged


def without(points: Sequence[Point], index: int) -> tuple[Point, ...]:
    """All points but one."""
    return (*points[:index], *points[index + 1 :])


def _progress(memory: Memory, left: float) -> Memory:
    """Note it where the robot has less far to go than ever during this move."""
    if left < memory.nearest - PROGRESS:
        return replace(memory, nearest=left, loose=0)
    return memory


def _blockage(sight: Sight, start: Point, goal: Point) -> float:
    """By how many units the straight way is narrower than needed, for all blocks beside it."""
    total = 0.0
    for other in sight.blocks:
        near = gap(start, goal, other)
        if near < min(WAY, math.dist(start, other)):
            total += WAY - near
    return total


def _shortage(place: Point, blocks: Sequence[Point]) -> float:
    return sum(max(0.0, ROOM - math.dist(place, block)) for block in blocks)


def _is_done(sight: Sight, move: Move) -> bool:
    place = (sight.x, sight.y) if move.block is None else sight.resting[move.block]
    if move.area is not None and move.area.contains(*place):
        return True
    return math.dist(place, move.goal) < move.tolerance


def _watch(sight: Sight, memory: Memory) -> Memory:
    """Notice whether the robot gets anywhere, and start an escape where it does not."""
    late = memory.loose > SEARCH or memory.age > HAUL
    x, y, angle = memory.mark
    if math.dist((x, y), (sight.x, sight.y)) > 0.06 or abs(angle - sight.angle) > 0.4:
        memory = replace(memory, mark=(sight.x, sight.y, sight.angle), still=0)
    elif memory.still < PATIENCE:
        memory = replace(memory, still=memory.still + 1)
    else:
        late = True
    return _give_up(memory) if late and not memory.escape else memory


def _give_up(memory: Memory) -> Memory:
    move = memory.move
    given_up = () if move is None or move.block is None else (move.block,)
    return replace(
        memory,
        still=0,
        loose=0,
        nearest=FAR,
        age=0,
        failures=memory.failures + 1,
        escape=ESCAPE,
        pull=memory.held > 0 and not memory.pull,
        avoid=(*given_up, *memory.avoid)[:3],
        move=None,
        rest=0,
    )


def _escape(memory: Memory) -> int:
    """Let go and drive away: backwards, then on other ways should that not have helped."""
    ways = (
        (Longitudinal.BACK, Turn.STRAIGHT),
        (Longitudinal.BACK, Turn.LEFT),
        (Longitudinal.BACK, Turn.RIGHT),
        (Longitudinal.FORWARD, Turn.LEFT),
        (Longitudinal.FORWARD, Turn.RIGHT),
    )
    if memory.pull:
        return Action(Longitudinal.BACK, Turn.STRAIGHT, Gripper.CLOSED).id
    return Action(*ways[(memory.failures - 1) % len(ways)]).id


def expert_for(
    task: str,
    *,
    seed: int | None = None,
    rng: np.random.Generator | None = None,
    skill: float = 1.0,
) -> Expert:
    """The expert of a task, with the strategy that `seed` (or `rng`) draws.

    Below `skill` 1 it makes mistakes: noise, detours, sometimes wrong goals.

    Raises:
        NoExpertError: the task has none.
        InvalidConfigError: the skill is not between 0 and 1.
    """
    goals = goals_of(task)
    rng = np.random.default_rng(seed) if rng is None else rng
    style = Style.draw(rng, grasp.SIDES)
    return Expert(goals, style, None if skill == 1.0 else Clumsiness(1.0 - skill, rng))
