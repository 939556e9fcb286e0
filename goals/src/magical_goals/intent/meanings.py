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
from magical_goals.language import expressions as e
from magical_goals.language import goals as g
from magical_goals.language.expressions import Blocks, Expression, Place, Selection
from magical_goals.language.goals import Goal
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
    """A set of goals that are equivalent in all scenes."""

    goal: Goal  # the most probable one
    weight: float  # their total prior probability

    def __and__(self, other: "Meaning") -> "Meaning":
        """Both goals together, in either order."""
        weight = 2 * _probability(choice(g.Together)) * self.weight * other.weight
        return Meaning(g.Together(self.goal, other.goal), weight)


class Language:
    """The selections of at most two parts and the goals of one part, in given scenes.

    `alternatives` has, by the blocks named in each scene, the selections that name them, weighted.
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
        everything = self.named_by(e.AllBlocks())
        single = [(s, bits_of_part(s), self.named_by(s)) for s in simple_expressions(Selection)]
        but = choice(e.AllBut)
        negated = [
            (e.AllBut(s), but + bits, tuple(map(operator.sub, everything, named)))
            for s, bits, named in single
        ]
        yield from (*single, *negated)
        known = [each for each in single if all(each[2])]
        for (a, bits_a, in_a), (b, bits_b, in_b) in combinations(known, 2):
            both = bits_a + bits_b
            yield e.And(a, b), choice(e.And) + both, tuple(map(operator.and_, in_a, in_b))
            yield e.Or(a, b), choice(e.Or) + both, tuple(map(operator.or_, in_a, in_b))
        for (a, bits_a, in_a), (b, bits_b, in_b) in product(known, negated):
            if a != b.selection:
                yield (
                    e.And(a, b),
                    choice(e.And) + bits_a + bits_b,
                    tuple(map(operator.and_, in_a, in_b)),
                )

    def meanings(self) -> Iterator[Meaning]:
        """The meanings of all goals of one part."""
        alternatives = self.alternatives.values()
        chosen = [(max(each, key=each.__getitem__), sum(each.values())) for each in alternatives]
        places = [(place, _probability(bits_of_part(place))) for place in simple_expressions(Place)]
        beside = _probability(choice(e.Beside))
        of_one_part = [each for each in chosen if not isinstance(each[0], e.AllBut | e.And | e.Or)]
        places += [(e.Beside(selection), beside * weight) for selection, weight in of_one_part]
        for kind in (g.Each, g.Every, g.OneOf):
            of_kind = _probability(choice(kind))
            for (selection, weight), (place, of_place) in product(chosen, places):
                yield Meaning(kind(selection, place), of_kind * weight * of_place)
        for simple in (g.Exactly, g.Only, g.Undisturbed, g.Lined):
            of_kind = _probability(choice(simple))
            yield from (Meaning(simple(each), of_kind * weight) for each, weight in chosen)
        several = all(len(scene.blocks) > 1 for scene in self.scenes)
        for goal in (*(map(g.Clustered, e.Attribute) if several else ()), g.RobotInside()):
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
