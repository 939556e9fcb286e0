"""The posterior over programs, given demonstrations of one task.

Goals of one part are all weighed, then the best of them together with each other: a beam search by
posterior probability. At first only one demonstration is looked at, then all for the best goals.

Demonstrations of one scene share their demonstrator's habits, such as the side from which a block
is pushed, which a goal may fit by chance. So n demonstrations count as the square root of n.
"""

import math
from collections.abc import Iterable, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
from scipy.special import expit

from magical.learning.intent.demonstrator import Episode
from magical.learning.intent.meanings import Language, Meaning
from magical.tasks.programs import Goal

FIRST_PASS = 150  # meanings of the first demonstration that are held against all
BEAM = 24  # meanings that are combined with each other
MOST = 100  # explanations that are kept
WORDINGS = 6  # selections of the same blocks that are told apart
LEAST_WEIGHT = 0.5  # of the most probable meaning: below, it is not known which
LEAST_SHARE = 1e-3  # of the most probable meaning's weight: less is left out

Scored = list[tuple[float, Meaning]]  # logarithm of the posterior probability, unnormalised


class Explanation(NamedTuple):
    """A program and its probability, if there is any program."""

    program: Goal
    weight: float


class Belief(NamedTuple):
    """What is believed of a task.

    Attributes:
        explanations: the most probable first.
        unexplained: the probability that there is no program.
        largest: the probability of the most probable meaning, however it is written.
    """

    explanations: Sequence[Explanation]
    unexplained: float
    largest: float

    @property
    def is_explained(self) -> bool:
        """Whether any program explains the demonstrations."""
        return self.unexplained < LEAST_WEIGHT

    @property
    def is_known(self) -> bool:
        """Whether it is known, too, what the programs mean in the demonstrated scenes."""
        return self.is_explained and self.largest >= LEAST_WEIGHT

    @property
    def verdict(self) -> str:
        """The same in a sentence."""
        if not self.is_explained:
            return f"no program explains the demonstrations (probability {self.unexplained:.2f})"
        known = "known" if self.is_known else "not known"
        return f"{known}: the most probable meaning in Demo has probability {self.largest:.2f}"


def infer(episodes: Sequence[Episode]) -> Belief:
    """The posterior of the programs that demonstrations have in common."""
    search = _Search(episodes)
    found = search.run()
    weights = [math.exp(value - found[0][0]) for value, _ in found]
    total = sum(weights)
    explanations = [
        Explanation(program, weight / total * share)
        for weight, (_, meaning) in zip(weights, found, strict=True)
        if weight > weights[0] * LEAST_SHARE
        for program, share in search.language.wordings(meaning.goal, WORDINGS)
    ]
    return Belief(
        sorted(explanations, key=lambda each: -each.weight)[:MOST],
        search.probability_of_none(found),
        weights[0] / total,
    )


class _Search:
    """For the most probable meanings."""

    def __init__(self, episodes: Sequence[Episode]) -> None:
        self.language = Language([episode.scene for episode in episodes])
        self.evidence = math.sqrt(len(episodes))
        self._episodes = episodes

    def run(self) -> Scored:
        """The best first: goals of one part, and pairs of them."""
        single = self._in_two_passes(self.language.meanings())
        pairs = [a & b for (_, a), (_, b) in combinations(single[:BEAM], 2)]
        return sorted(single + self._in_two_passes(pairs), key=lambda pair: -pair[0])

    def probability_of_none(self, found: Scored) -> float:
        """That the demonstrator has no program, which is as probable as any before.

        Unlike the programs it is weighed by all demonstrations in full, whose random moves would
        have nothing in common.
        """
        slips = sum(episode.log_likelihood_of_slips for episode in self._episodes)
        scale = len(self._episodes) / self.evidence
        gains = []
        for value, meaning in found:
            prior = math.log(meaning.weight)
            gains.append(prior + (value - prior) * scale - slips)
        return float(expit(-np.logaddexp.reduce(gains)))

    def _in_two_passes(self, meanings: Iterable[Meaning]) -> Scored:
        """Those that the first demonstration leaves most probable, held against all."""
        best = self._score(meanings, 1)[:FIRST_PASS]
        return self._score((meaning for _, meaning in best), len(self._episodes))

    def _score(self, meanings: Iterable[Meaning], count: int) -> Scored:
        """The best first, as if all demonstrations were like the first `count`."""
        found = [(math.log(m.weight) + self._likelihood(m.goal, count), m) for m in meanings]
        return sorted(found, key=lambda pair: -pair[0])

    def _likelihood(self, goal: Goal, count: int) -> float:
        literal = (self.language.literal(goal, number) for number in range(count))
        return self.evidence * sum(map(Episode.log_likelihood, self._episodes, literal)) / count
