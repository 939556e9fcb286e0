"""Programs by what they mean in the scenes of demonstrations.

Programs whose selections name the same blocks cannot be told apart there, so they are one meaning:
one goal for the likelihood, with all selections that it may have been written with.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from itertools import combinations, product
from typing import Any, TypeVar, cast

from magical.scene import Scene
from magical.tasks.programs import (
    AllBut,
    And,
    Attribute,
    Beside,
    Clustered,
    Each,
    Every,
    Exactly,
    Expression,
    Goal,
    Lined,
    OneOf,
    Only,
    Or,
    Place,
    RobotInside,
    Selection,
    Undisturbed,
)
from magical.tasks.programs.prior import Prior, simple_expressions
from magical.tasks.programs.selections import Blocks

Named = tuple[Blocks, ...]  # the blocks that a selection names in each scene
AnyExpression = TypeVar("AnyExpression", bound=Expression)


@dataclass(frozen=True, repr=False)
class Chosen(Selection):
    """Blocks by their numbers, in place of an expression that names them."""

    named: Blocks

    def __post_init__(self) -> None:
        """Nothing: the field is no word of the language."""

    def blocks(self, scene: Scene) -> Blocks:
        """See `Selection`."""
        return self.named


@dataclass(frozen=True)
class Alternatives:
    """The selections that name the same blocks in all scenes, with their weights."""

    named: Named
    selections: Sequence[Selection]
    weights: Sequence[float]

    @property
    def heaviest(self) -> Selection:
        """The most probable one."""
        return max(zip(self.weights, self.selections, strict=True), key=lambda pair: pair[0])[1]


@dataclass(frozen=True)
class Meaning:
    """Goals that are the same in all scenes.

    Attributes:
        goal: the most probable one.
        weight: the probability of all of them.
    """

    goal: Goal
    weight: float


class Language:
    """The selections of at most two parts and the goals of one part, in some scenes."""

    def __init__(self, scenes: Sequence[Scene], prior: Prior) -> None:
        """Find all selections that name a block in each scene."""
        self.scenes, self.prior = scenes, prior
        found: dict[Named, dict[Selection, float]] = {}
        for selection, weight in self._selections():
            named = self.named_by(selection)
            if all(named):
                found.setdefault(named, {})[selection] = weight
        self.alternatives: Mapping[Named, Alternatives] = {
            named: Alternatives(named, tuple(each), tuple(each.values()))
            for named, each in found.items()
        }

    def named_by(self, selection: Selection) -> Named:
        """The blocks that a selection names in each scene."""
        return tuple(selection.blocks(scene) for scene in self.scenes)

    def _selections(self) -> Iterator[tuple[Selection, float]]:
        prior = self.prior
        single = [s for s in simple_expressions(Selection) if isinstance(s, Selection)]
        bits = {s: prior.bits(s) for s in single}
        link = {kind: prior.choice(kind) for kind in (AllBut, And, Or)}
        for selection in single:
            yield selection, 2.0 ** -bits[selection]
            yield AllBut(selection), 2.0 ** -(link[AllBut] + bits[selection])
        known = [s for s in single if all(self.named_by(s))]
        for a, b in combinations(known, 2):
            for kind in (And, Or):
                yield kind(a, b), 2.0 ** -(link[kind] + bits[a] + bits[b])
        for a, b in product(known, repeat=2):
            if a != b:
                yield And(a, AllBut(b)), 2.0 ** -(link[And] + link[AllBut] + bits[a] + bits[b])

    def meanings(self) -> Iterator[Meaning]:
        """Every goal of one part."""
        chosen = [(a.heaviest, sum(a.weights)) for a in self.alternatives.values()]
        places: list[tuple[Place, float]] = [
            (place, 2.0 ** -self.prior.bits(place))
            for place in simple_expressions(Place)
            if isinstance(place, Place)
        ]
        beside = 2.0 ** -self.prior.choice(Beside)
        places += [(Beside(selection), beside * weight) for selection, weight in chosen]
        for kind in (Each, Every, OneOf):
            choice = 2.0 ** -self.prior.choice(kind)
            for (selection, weight), (place, place_weight) in product(chosen, places):
                yield Meaning(kind(selection, place), choice * weight * place_weight)
        for simple in (Exactly, Only, Undisturbed, Lined):
            choice = 2.0 ** -self.prior.choice(simple)
            yield from (Meaning(simple(selection), choice * weight) for selection, weight in chosen)
        several = all(len(scene.blocks) > 1 for scene in self.scenes)
        for goal in (*(map(Clustered, Attribute) if several else ()), RobotInside()):
            yield Meaning(goal, 2.0 ** -self.prior.bits(goal))

    def literal(self, goal: Goal) -> list[Goal]:
        """The goal in each scene, with the blocks that its selections name there."""
        return [
            replace_selections(goal, lambda s, k=k: Chosen(self.named_by(s)[k]))  # type: ignore[misc]
            for k in range(len(self.scenes))
        ]

    def wordings(self, goal: Goal, most: int) -> Iterator[tuple[Goal, float]]:
        """Goals of the same meaning and their shares, with the `most` probable of selections."""
        choices = []
        for selection in outer_selections(goal):
            among = self.alternatives[self.named_by(selection)]
            pairs = zip(among.weights, among.selections, strict=True)
            order = sorted(pairs, key=lambda pair: -pair[0])[:most]
            choices.append([(chosen, weight / sum(among.weights)) for weight, chosen in order])
        for chosen in product(*choices):
            parts = iter([selection for selection, _ in chosen])
            rewritten = replace_selections(goal, lambda _, parts=parts: next(parts))
            yield rewritten, math.prod(share for _, share in chosen)


def outer_selections(expression: Expression) -> Iterator[Selection]:
    """The selections in an expression that are in no other, in order."""
    if isinstance(expression, Selection):
        yield expression
        return
    for part in _fields(expression):
        if isinstance(part, Expression):
            yield from outer_selections(part)


def replace_selections(
    expression: AnyExpression, replace: Callable[[Selection], Selection]
) -> AnyExpression:
    """The expression with each selection in it replaced."""
    if isinstance(expression, Selection):
        return cast(AnyExpression, replace(expression))
    return type(expression)(
        *(
            replace_selections(part, replace) if isinstance(part, Expression) else part
            for part in _fields(expression)
        )
    )


def _fields(expression: Expression) -> list[Any]:
    return [getattr(expression, each.name) for each in fields(expression)]  # type: ignore[arg-type]
