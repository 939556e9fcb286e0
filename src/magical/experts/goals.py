"""What should be where: the moves that a task still asks for, seen from any state.

A task's goals are one function of what is seen and of a `Style`. Tasks from outside the package
register theirs with `register_goals`.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from magical.errors import NoExpertError
from magical.experts.sight import Sight
from magical.scene import Region, Scene
from magical.scene.geometry import Point

MAX_BLOCKS = 16  # blocks that have a taste of their own; more share them


@dataclass(frozen=True, slots=True)
class Move:
    """Bring a block (or the robot itself, where `block` is None) within `tolerance` of a goal."""

    goal: Point
    tolerance: float  # units
    block: int | None = None
    weight: float = 0.0  # control steps by which the move may wait: larger is later
    area: Region | None = None  # the move is also made once its block is in here


@dataclass(frozen=True, slots=True)
class Style:
    """What makes one demonstrator different from the next: drawn once, from a seed."""

    sides: tuple[float, ...]  # extra cost of each bearing to grasp from, in control steps
    order: tuple[float, ...]  # extra cost of each block, in control steps
    places: tuple[float, ...]  # in [0, 1): which places and orientations are liked

    @staticmethod
    def draw(rng: np.random.Generator, sides: int) -> "Style":
        """One demonstrator's tastes."""
        return Style(
            tuple((4.0 * rng.random(sides)).tolist()),
            tuple((12.0 * rng.random(MAX_BLOCKS)).tolist()),
            tuple(rng.random(64).tolist()),
        )


@dataclass(frozen=True, slots=True)
class Plan:
    """The moves still to make, and what to remember so that the next plan agrees with this one."""

    moves: tuple[Move, ...] = ()
    places: tuple[Point, ...] = ()


NO_PLAN = Plan()


def _never(sight: Sight) -> bool:
    return False


def _always(scene: Scene) -> str:
    return ""


@dataclass(frozen=True, slots=True)
class Goals:
    """A task as its expert sees it."""

    plan: Callable[[Sight, Style, Plan], Plan]  # the moves still to make; the last plan is given
    solved: Callable[[Sight], bool] = _never  # cheap: whether to let go at once, all is well
    unsolvable: Callable[[Scene], str] = _always  # why a scene has no solution, or an empty text


_GOALS: dict[str, Goals] = {}


def register_goals(task: str, goals: Goals) -> None:
    """Give a task an expert."""
    _GOALS[task] = goals


def goals_of(task: str) -> Goals:
    """The goals of a task; raises `NoExpertError` where none are known."""
    try:
        return _GOALS[task]
    except KeyError:
        known = ", ".join(sorted(_GOALS))
        raise NoExpertError(
            f"{task!r} has no scripted expert; expected one of: {known}; "
            "register_goals gives a task one"
        ) from None
