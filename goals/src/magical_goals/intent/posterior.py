"""The posterior over programs, given demonstrations of one task.

All goals of one part are scored, then pairs of the best ones: a beam search by posterior
probability. Goals are first scored on one demonstration, and the best ones then on all.
Demonstrations of one scene share their demonstrator's habits, such as the side from which a block
is pushed, which a goal may fit by chance. So n demonstrations count as sqrt(n) independent ones.

The demonstrator is softly rational: in each state it stops, or moves one thing somewhere, with a
preference that is exponential in the work towards the goal that the move saves, minus its cost.
Occasionally it slips: moves anything anywhere, or stops.
"""

import math
from collections.abc import Iterable, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
from scipy.special import expit
from scipy.stats import qmc

from magical.scene import (
    COLOURS,
    FIRST_BLOCK,
    ROBOT,
    SHAPES,
    Block,
    Point,
    Pose,
    Poses,
    Region,
    Scene,
)
from magical.scene.constants import WORKSPACE_HALF
from magical_goals.intent.meanings import Language, Meaning
from magical_goals.language.expressions import Floats
from magical_goals.language.goals import Goal, States
from magical_goals.objects.data import ParsedDemonstration
from magical_goals.objects.parser import ABSENT, ParsedFrames

RATIONALITY = 8.0  # nats per unit of work
SLIPS = 0.2  # probability of a slip in each state
MOVE_COST = 0.25  # units of work: a move that saves less is not worthwhile
ALTERNATIVES = 96  # evenly spread other moves to compare with in each state
MARGIN = 0.12  # units from the walls to the places of other moves
FIRST_PASS = 150  # best meanings by the first demonstration, which are scored on all
BEAM = 24  # meanings that are combined with each other
MOST = 100  # explanations to keep
WORDINGS = 6  # selections of the same blocks to keep
LEAST_WEIGHT = 0.5  # least probability of a program, or of a meaning, that counts as known
LEAST_SHARE = 1e-3  # share of the most probable meaning's weight: less is left out

Scored = list[tuple[float, Meaning]]  # the unnormalised log-posterior


class Episode:
    """A demonstration as moves, after which the demonstrator stopped."""

    def __init__(
        self, scene: Scene, states: Sequence[Poses], ends: Sequence[Poses], rng: np.random.Generator
    ) -> None:
        """Take the states in which each move was made, and the final one, and those they led to.

        `rng` samples the moves that could have been made instead.
        """
        self.scene, self._count = scene, len(states)
        others = [_random_moves(state.bodies, rng) for state in states]
        bodies = np.stack([state.bodies for state in (*states, *ends)])
        self._states = States(scene, np.concatenate([bodies, *others]))

    def log_likelihood(self, goal: Goal) -> float:
        """The log-likelihood in nats; that of a move is a density relative to random moves."""
        work = self._states.work(goal)
        if not np.isfinite(work).all():
            return -np.inf
        n = self._count
        states, ends, others = work[:n], work[n : 2 * n - 1], work[2 * n - 1 :].reshape(n, -1)
        alternatives = np.exp(RATIONALITY * (states[:, None] - others - MOVE_COST)).mean(axis=1)
        made = np.exp(RATIONALITY * (states[:-1] - ends - MOVE_COST))
        rational = np.append(made, 1.0) / (1.0 + alternatives)
        return float(np.log((1.0 - SLIPS) * rational + SLIPS / 2).sum())

    @property
    def log_likelihood_of_slips(self) -> float:
        """The log-likelihood, in nats, with no goal: in each state a random move, or a stop."""
        return self._count * math.log(0.5)


def _random_moves(bodies: Floats, rng: np.random.Generator) -> Floats:
    """The poses after each of `ALTERNATIVES` random moves of a block or the robot."""
    rows = np.array([ROBOT, *range(FIRST_BLOCK, len(bodies))])
    which, *places = qmc.Halton(3, rng=rng).random(ALTERNATIVES).T
    moves = np.repeat(bodies[None], ALTERNATIVES, axis=0)
    limit = WORKSPACE_HALF - MARGIN
    moved = rows[(which * len(rows)).astype(np.intp)]
    moves[np.arange(ALTERNATIVES), moved, :2] = (2 * np.stack(places, axis=1) - 1) * limit
    return moves


def parsed_scene(parsed: ParsedFrames, frame: int) -> Scene:
    """The scene of one frame; blocks are numbered as parsed, with unknown angles set to 0."""
    blocks = [
        Block(SHAPES[shape], COLOURS[colour], Pose(x, y, 0.0))
        for (x, y), colour, shape in zip(
            parsed.blocks[frame], parsed.colours[frame], parsed.shapes[frame], strict=True
        )
        if colour != ABSENT
    ]
    regions = [
        Region.from_centre(COLOURS[colour], x, y, 2 * half_height, 2 * half_width)
        for (x, y, half_width, half_height), colour in zip(
            parsed.regions[frame], parsed.region_colours[frame], strict=True
        )
        if colour != ABSENT
    ]
    return Scene(Pose(*parsed.robot[frame]), tuple(blocks), tuple(regions))


def parsed_poses(parsed: ParsedFrames, frame: int, scene: Scene) -> Poses:
    """The poses in a frame of an episode that started from the scene and was tracked since."""
    bodies = Poses.at_rest(scene).bodies
    bodies[ROBOT] = parsed.robot[frame]
    bodies[FIRST_BLOCK:, :2] = parsed.blocks[frame, : len(scene.blocks)]
    return Poses(bodies)


def parsed_episode(shown: ParsedDemonstration, rng: np.random.Generator) -> Episode:
    """A demonstration as the moves that were made."""
    parsed, scene = shown.parsed, parsed_scene(shown.parsed, 0)
    if shown.carries:  # where a carry leaves the robot is not a goal
        parsed = parsed._replace(robot=np.repeat(parsed.robot[:1], len(parsed.robot), axis=0))
    states, ends = ([parsed_poses(parsed, t, scene) for t in frames] for frames in moves(shown))
    return Episode(scene, states, ends, rng)


def moves(shown: ParsedDemonstration) -> tuple[list[int], list[int]]:
    """The frames in which moves (carries, or the robot's way) start, with the final one, and end.

    Each starts where the last one ended, unless a watched policy acted in between.
    """
    demonstrated = shown.trajectory.is_demonstrated
    spans = [(first, last + 1) for _, first, last in shown.carries]
    if not spans:
        others = np.flatnonzero(~demonstrated[: shown.end])
        spans = [(int(others[-1]) + 1 if len(others) else 0, shown.end)]
    ends = [end for _, end in spans]
    starts = [
        before if demonstrated[before:start].all() else start
        for before, (start, _) in zip([0, *ends], [*spans, (shown.end, shown.end)], strict=True)
    ]
    return starts, ends


class Explanation(NamedTuple):
    """A program and its probability, given that there is a program."""

    program: Goal
    weight: float


class Belief(NamedTuple):
    """The belief about a task."""

    explanations: Sequence[Explanation]  # the most probable first
    unexplained: float  # the probability that there is no program
    largest: float  # that of the most probable meaning in all its wordings, if there is one
    contradiction: str = ""  # what acting on it would not do; see `checking`
    ends: Sequence[Point] = ()  # where demonstrations left what they moved

    @property
    def is_explained(self) -> bool:
        """Whether any program explains the demonstrations."""
        return self.unexplained < LEAST_WEIGHT and not self.contradiction

    @property
    def is_known(self) -> bool:
        """Whether the meaning of the programs in the demonstrated scenes is known, too."""
        return self.is_explained and self.largest >= LEAST_WEIGHT

    @property
    def verdict(self) -> str:
        """The belief in a sentence."""
        if self.contradiction:
            return f"no program explains the demonstrations: {self.contradiction}"
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

        Here all demonstrations count in full: random moves would have nothing in common.
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
