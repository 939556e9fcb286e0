"""How likely demonstrations are under a goal, for a softly rational demonstrator.

In each state the demonstrator stops, or moves one thing somewhere. The preference for a move is
exponential in the work towards the goal that it saves, minus the cost of a move. Occasionally the
demonstrator slips: moves anything anywhere, or stops.
"""

import math
from collections.abc import Sequence

import numpy as np
from scipy.stats import qmc

from magical.scene import COLOURS, SHAPES, Block, Pose, Poses, Region, Scene
from magical.scene.constants import WORKSPACE_HALF
from magical.scene.poses import FIRST_BLOCK, ROBOT
from magical_goals.language.expressions import Floats
from magical_goals.language.goals import Goal, States
from magical_goals.objects.data import ParsedDemonstration
from magical_goals.objects.parser import ABSENT, ParsedFrames

RATIONALITY = 8.0  # nats per unit of work
SLIPS = 0.2  # probability of a slip in each state
MOVE_COST = 0.25  # units of work: a move that saves less is not worthwhile
ALTERNATIVES = 96  # evenly spread other moves to compare with in each state
MARGIN = 0.12  # units from the walls to the places of other moves


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
