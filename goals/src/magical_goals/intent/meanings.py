"""Programs grouped by their meaning in the scenes of demonstrations.

Programs whose selections name the same blocks cannot be distinguished there, so they have one
meaning: one goal for the likelihood, with all selections that it can be written with.
"""

import math
import operator
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, product
from typing import TypeVar, cast

from magical.scene import Scene
from magical_goals.language.expressions import (
    AllBlocks,
    AllBut,
    And,
    Attribute,
    Beside,
    Blocks,
    Expression,
    Or,
    Place,
    Selection,
)
from magical_goals.language.goals import (
    Clustered,
    Each,
    Every,
    Exactly,
    Goal,
    Lined,
    OneOf,
    Only,
    RobotInside,
    Together,
    Undisturbed,
)
from magical_goals.language.parsing import bits_of_part, choice, simple_expressions

Named = tuple[Blocks, ...]  # the blocks that a selection names in each scene
AnyExpression = TypeVar("AnyExpression", bound=Expression)


@dataclass(frozen=True, repr=False)
class Chosen(Selection):
    """Blocks by their numbers, in place of an expression that names them."""

    named: Blocks

    def __post_init__(self) -> None:
        """Skip the check of the base class: the field is not part of the language."""

    def blocks(self, scene: Scene) -> Blocks:
        """See `Selection`."""
        return self.named


@dataclass(frozen=True)
class Meaning:
    """A set of goals that are equivalent in all scenes.

    Attributes:
        goal: the most probable one.
        weight: their total prior probability.
    """

    goal: Goal
    weight: float

    def __and__(self, other: "Meaning") -> "Meaning":
        """Both goals together, in either order."""
        weight = 2 * _probability(choice(Together)) * self.weight * other.weight
        return Meaning(Together(self.goal, other.goal), weight)


class Language:
    """The selections of at most two parts and the goals of one part, in given scenes.

    Attributes:
        alternatives: by the blocks named in each scene, the selections that name them, and weights.
    """

    def __init__(self, scenes: Sequence[Scene]) -> None:
        """Find all selections that name at least one block in each scene."""
        self.scenes = scenes
        self._named: dict[Selection, Named] = {}
        self.alternatives: dict[Named, dict[Selection, float]] = {}
        for selection, bits, named in self._selections():
            if all(named):
                self._named[selection] = named
                self.alternatives.setdefault(named, {})[selection] = _probability(bits)

    def named_by(self, selection: Selection) -> Named:
        """The blocks that a selection names in each scene."""
        return tuple(selection.blocks(scene) for scene in self.scenes)

    def _selections(self) -> Iterator[tuple[Selection, float, Named]]:
        """Selections of at most two parts, their bits, and the blocks that they name."""
        everything = self.named_by(AllBlocks())
        single = [(s, bits_of_part(s), self.named_by(s)) for s in simple_expressions(Selection)]
        but = choice(AllBut)
        negated = [
            (AllBut(s), but + bits, tuple(map(operator.sub, everything, named)))
            for s, bits, named in single
        ]
        yield from (*single, *negated)
        known = [each for each in single if all(each[2])]
        for (a, bits_a, in_a), (b, bits_b, in_b) in combinations(known, 2):
            both = bits_a + bits_b
            yield And(a, b), choice(And) + both, _and(in_a, in_b)
            yield Or(a, b), choice(Or) + both, tuple(map(operator.or_, in_a, in_b))
        for (a, bits_a, in_a), (b, bits_b, in_b) in product(known, negated):
            if a != b.selection:
                yield And(a, b), choice(And) + bits_a + bits_b, _and(in_a, in_b)

    def meanings(self) -> Iterator[Meaning]:
        """The meanings of all goals of one part."""
        alternatives = self.alternatives.values()
        chosen = [(max(each, key=each.__getitem__), sum(each.values())) for each in alternatives]
        places = [(place, _probability(bits_of_part(place))) for place in simple_expressions(Place)]
        beside = _probability(choice(Beside))
        of_one_part = [each for each in chosen if not isinstance(each[0], AllBut | And | Or)]
        places += [(Beside(selection), beside * weight) for selection, weight in of_one_part]
        for kind in (Each, Every, OneOf):
            of_kind = _probability(choice(kind))
            for (selection, weight), (place, of_place) in product(chosen, places):
                yield Meaning(kind(selection, place), of_kind * weight * of_place)
        for simple in (Exactly, Only, Undisturbed, Lined):
            of_kind = _probability(choice(simple))
            yield from (Meaning(simple(each), of_kind * weight) for each, weight in chosen)
        several = all(len(scene.blocks) > 1 for scene in self.scenes)
        for goal in (*(map(Clustered, Attribute) if several else ()), RobotInside()):
            yield Meaning(goal, _probability(bits_of_part(goal)))

    def literal(self, goal: Goal, number: int) -> Goal:
        """The goal in scene `number`, with the blocks named there in place of the selections."""
        return replace_selections(goal, lambda s: Chosen(self._named[s][number]))

    def wordings(self, goal: Goal, most: int) -> Iterator[tuple[Goal, float]]:
        """Goals of the same meaning, with each selection's `most` probable wordings, and shares."""
        choices = []
        for selection in outer_selections(goal):
            among = self.alternatives[self._named[selection]]
            total = sum(among.values())
            order = sorted(among.items(), key=lambda pair: -pair[1])[:most]
            choices.append([(chosen, weight / total) for chosen, weight in order])
        for chosen in product(*choices):
            selections = iter([selection for selection, _ in chosen])

            def next_one(_: Selection, rest: Iterator[Selection] = selections) -> Selection:
                return next(rest)

            yield replace_selections(goal, next_one), math.prod(share for _, share in chosen)


def _probability(bits: float) -> float:
    return float(2.0**-bits)


def _and(a: Named, b: Named) -> Named:
    return tuple(map(operator.and_, a, b))


def outer_selections(expression: Expression) -> Iterator[Selection]:
    """The selections in an expression that are not part of another selection, in order."""
    if isinstance(expression, Selection):
        yield expression
        return
    for part in expression.arguments:
        if isinstance(part, Expression):
            yield from outer_selections(part)


def replace_selections(
    expression: AnyExpression, replace: Callable[[Selection], Selection]
) -> AnyExpression:
    """The expression with each of its outer selections replaced."""
    if isinstance(expression, Selection):
        return cast(AnyExpression, replace(expression))
    return type(expression)(
        *(
            replace_selections(part, replace) if isinstance(part, Expression) else part
            for part in expression.arguments
        )
    )
