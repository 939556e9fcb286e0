"""The posterior over programs, given demonstrations of one task.

Goals of one part are all weighed, then the best of them together with each other: a beam search by
posterior probability. At first only one demonstration is looked at, then all for the best goals.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from itertools import combinations, product
from typing import NamedTuple

from magical.learning.intent.demonstrator import Episode
from magical.learning.intent.meanings import Language, Meaning
from magical.tasks.programs import Goal, Together
from magical.tasks.programs.prior import Prior

FIRST_PASS = 200  # meanings of the first demonstration that are held against all
BEAM = 24  # meanings that are combined with each other
WORDINGS = 6  # selections of the same blocks that are told apart
LEAST_EVIDENCE = 1.0  # nats a demonstration: below, no program explains them
LEAST_WEIGHT = 0.5  # of the most probable meaning: below, it is not known which

Scored = list[tuple[float, Meaning]]  # logarithm of the posterior probability, unnormalised


class Explanation(NamedTuple):
    """A program and its probability."""

    program: Goal
    weight: float


class Belief(NamedTuple):
    """What is believed of a task.

    Attributes:
        explanations: the most probable first.
        evidence: nats by which the best program explains a demonstration better than random moves.
        largest: the probability of the most probable meaning, however it is written.
    """

    explanations: Sequence[Explanation]
    evidence: float
    largest: float

    @property
    def is_explained(self) -> bool:
        """Whether any program explains the demonstrations."""
        return self.evidence >= LEAST_EVIDENCE

    @property
    def is_known(self) -> bool:
        """Whether it is known, too, what the programs mean in the demonstrated scenes."""
        return self.is_explained and self.largest >= LEAST_WEIGHT


def infer(episodes: Sequence[Episode], prior: Prior) -> Belief:
    """The posterior of the programs that demonstrations have in common."""
    language = Language([episode.scene for episode in episodes], prior)
    total = len(episodes)

    def likelihood(goal: Goal, count: int) -> float:
        """The mean over the first demonstrations."""
        pairs = zip(language.literal(goal), episodes[:count], strict=False)
        return sum(episode.log_likelihood(each) for each, episode in pairs) / count

    def score(meanings: Iterable[Meaning], count: int) -> Scored:
        """The best first, as if all demonstrations were like the first `count`."""
        found = [(math.log(m.weight) + total * likelihood(m.goal, count), m) for m in meanings]
        return sorted(found, key=lambda pair: -pair[0])

    found = _in_two_passes(score, language.meanings(), total)
    link = 2.0 ** -prior.choice(Together)
    single = [meaning for _, meaning in found[:BEAM]]
    pairs = [_together(a, b, 2 * link) for a, b in combinations(single, 2)]
    two = _in_two_passes(score, pairs, total)
    three = [
        _together(a, b, 2 * link) for (_, a), b in product(two[: BEAM // 4], single[: BEAM // 2])
    ]
    found = sorted(found + two + _in_two_passes(score, three, total), key=lambda pair: -pair[0])
    weights = [math.exp(value - found[0][0]) for value, _ in found]
    explanations = [
        Explanation(program, weight / sum(weights) * share)
        for weight, (_, meaning) in zip(weights, found, strict=True)
        if weight > weights[0] * 1e-3
        for program, share in language.wordings(meaning.goal, WORDINGS)
    ]
    return Belief(
        sorted(explanations, key=lambda each: -each.weight),
        max(value - math.log(meaning.weight) for value, meaning in found) / total,
        weights[0] / sum(weights),
    )


def _together(a: Meaning, b: Meaning, weight: float) -> Meaning:
    """Both, in either order."""
    return Meaning(Together(a.goal, b.goal), weight * a.weight * b.weight)


def _in_two_passes(
    score: Callable[[Iterable[Meaning], int], Scored], meanings: Iterable[Meaning], total: int
) -> Scored:
    first = score(meanings, 1)[:FIRST_PASS]
    return score((meaning for _, meaning in first), total) if total > 1 else first
