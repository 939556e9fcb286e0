"""The posterior over programs, given demonstrations of one task.

All goals of one part are scored, then pairs of the best ones: a beam search by posterior
probability. Goals are first scored on one demonstration, and the best ones then on all.

Demonstrations of one scene share their demonstrator's habits, such as the side from which a block
is pushed, which a goal may fit by chance. So n demonstrations count as sqrt(n) independent ones.
"""

import math
from collections.abc import Iterable, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
from scipy.special import expit

from magical_goals.intent.demonstrator import Episode
from magical_goals.intent.meanings import Language, Meaning
from magical_goals.language import Goal

FIRST_PASS = 150  # best meanings by the first demonstration, which are scored on all
BEAM = 24  # meanings that are combined with each other
MOST = 100  # explanations to keep
WORDINGS = 6  # selections of the same blocks to keep
LEAST_WEIGHT = 0.5  # least probability of a program, or of a meaning, that counts as known
LEAST_SHARE = 1e-3  # share of the most probable meaning's weight: less is left out

Scored = list[tuple[float, Meaning]]  # the unnormalised log-posterior


class Explanation(NamedTuple):
    """A program and its probability, given that there is a program."""

    program: Goal
    weight: float


class Belief(NamedTuple):
    """The belief about a task."""

    explanations: Sequence[Explanation]  # the most probable first
    unexplained: float  # the probability that there is no program
    largest: float  # that of the most probable meaning in all its wordings, if there is one

    @property
    def is_explained(self) -> bool:
        """Whether any program explains the demonstrations."""
        return self.unexplained < LEAST_WEIGHT

    @property
    def is_known(self) -> bool:
        """Whether the meaning of the programs in the demonstrated scenes is known, too."""
        return self.is_explained and self.largest >= LEAST_WEIGHT

    @property
    def verdict(self) -> str:
        """The belief in a sentence."""
        if not self.is_explained:
            return f"no program explains the demonstrations (probability {self.unexplained:.2f})"
        known = "known" if self.is_known else "not known"
        return f"{known}: the most probable meaning in Demo has probability {self.largest:.2f}"


def infer(episodes: Sequence[Episode]) -> Belief:
    """The posterior over the program that the demonstrations have in common."""
    search = _Search(episodes)
    found = search.run()
    if found[0][0] == -math.inf:  # the language has no goal for such scenes
        return Belief([], 1.0, 0.0)
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
    """The search for the most probable meanings."""

    def __init__(self, episodes: Sequence[Episode]) -> None:
        self.language = Language([episode.scene for episode in episodes])
        self.evidence = math.sqrt(len(episodes))
        self._episodes = episodes

    def run(self) -> Scored:
        """The meanings of goals of one part and of pairs of them, the best first."""
        single = self._in_two_passes(self.language.meanings())
        pairs = [a & b for (_, a), (_, b) in combinations(single[:BEAM], 2)]
        return sorted(single + self._in_two_passes(pairs), key=lambda pair: -pair[0])

    def probability_of_none(self, found: Scored) -> float:
        """The probability that the demonstrator has no program; the prior odds are even.

        Here all demonstrations count in full, unlike when programs are compared with each other:
        random moves would have nothing in common.
        """
        slips = sum(episode.log_likelihood_of_slips for episode in self._episodes)
        scale = len(self._episodes) / self.evidence
        gains = []
        for value, meaning in found:
            prior = math.log(meaning.weight)
            gains.append(prior + (value - prior) * scale - slips)
        return float(expit(-np.logaddexp.reduce(gains)))

    def _in_two_passes(self, meanings: Iterable[Meaning]) -> Scored:
        """The most probable meanings by the first demonstration, scored on all."""
        best = self._score(meanings, 1)[:FIRST_PASS]
        return self._score((meaning for _, meaning in best), len(self._episodes))

    def _score(self, meanings: Iterable[Meaning], count: int) -> Scored:
        """Score meanings, the best first, as if all demonstrations were like the first `count`."""
        found = [(math.log(m.weight) + self._likelihood(m.goal, count), m) for m in meanings]
        return sorted(found, key=lambda pair: -pair[0])

    def _likelihood(self, goal: Goal, count: int) -> float:
        literal = (self.language.literal(goal, number) for number in range(count))
        return self.evidence * sum(map(Episode.log_likelihood, self._episodes, literal)) / count
