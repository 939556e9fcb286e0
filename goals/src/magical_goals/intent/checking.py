"""Whether acting on a belief would do what was demonstrated.

A goal may make all demonstrated moves likely and still not be what they have in common: "into a
region" fits demonstrations that all bring a block into the farther of two regions. So the belief is
acted on, in thought, from where each demonstration started, and what it leads to is compared with
where the demonstrations ended. Where these differ from one another, it may differ as much.
"""

from collections.abc import Sequence

import numpy as np

from magical.scene import FIRST_BLOCK, ROBOT, Poses
from magical_goals.intent.acting import Intention, row_of
from magical_goals.intent.posterior import Belief, parsed_poses, parsed_scene
from magical_goals.language.expressions import Floats
from magical_goals.objects.control import ROBOT_TARGET
from magical_goals.objects.data import ParsedDemonstration

MOST_MOVES = 12  # in thought
MOST_ENDS = 200  # to keep
# Chosen on training tasks of the generated suite, of which 4 of 64 are contradicted, the human
# demonstrations of the paper's tasks, of which none is, and the development tasks of
# studies/outside_tasks.
ELSEWHERE = 0.5  # units between a block's end and its nearest demonstrated one: more is elsewhere
SPREAD = 1.5  # times the demonstrations' own distance from each other, if that is more
DRIVEN = 1.1  # units from the last block that was moved: further away, the robot was driven


def contradiction(belief: Belief, demonstrations: Sequence[ParsedDemonstration]) -> str:
    """What acting on a belief would not do, in English; empty if it does what was demonstrated.

    Args:
        belief: about the task of the demonstrations, which are of one scene or of several.
        demonstrations: ten, say; with one there is nothing to compare.
    """
    gaps, spreads, drives = [], [], []
    for shown in demonstrations:
        ends, drives_robot = imagine(belief, shown)
        alike = [_ends(each) for each in demonstrations if _starts_alike(each, shown)]
        rows = slice(None) if drives_robot else slice(1, None)
        gaps.append(min(_furthest(ends[rows], other[rows]) for other in alike))
        own = _ends(shown)[rows]
        others = sorted(_furthest(own, other[rows]) for other in alike)
        spreads.append(others[1] if len(others) > 1 else np.inf)
        drives.append(0.0 if drives_robot else _away_from_last_block(shown))
    if np.median(gaps) > max(ELSEWHERE, SPREAD * max(spreads)):
        return "acting on them would end elsewhere"
    if np.median(drives) > DRIVEN:
        return "they do not tell where the robot was driven at the end"
    return ""


def imagine(belief: Belief, shown: ParsedDemonstration) -> tuple[Floats, bool]:
    """Act on a belief, in thought, from where a demonstration started.

    Returns:
        The positions of robot and N blocks at the end, (1 + N, 2), and whether the robot was driven
        somewhere for its own sake.
    """
    scene = parsed_scene(shown.parsed, 0)
    bodies = parsed_poses(shown.parsed, 0, scene).bodies
    intention, drives_robot = Intention(belief._replace(ends=()), scene), False
    for _ in range(MOST_MOVES):
        if (decision := intention.decide(Poses(bodies))) is None:
            break
        thing, place = decision
        drives_robot |= thing == ROBOT_TARGET
        bodies = bodies.copy()
        bodies[row_of(thing), :2] = place
    return _positions(bodies), drives_robot


def demonstrated_ends(demonstrations: Sequence[ParsedDemonstration]) -> list[tuple[float, float]]:
    """Where the blocks that were moved, or else the robot, ended; of many, `MOST_ENDS`."""
    ends = []
    for shown in demonstrations:
        moved = sorted({block for block, _, _ in shown.carries})
        places = _ends(shown)[[1 + block for block in moved] or [0]]
        ends += [(float(x), float(y)) for x, y in places.round(3)]
    return ends[:: 1 + len(ends) // MOST_ENDS]


def _ends(shown: ParsedDemonstration) -> Floats:
    """Where robot and N blocks ended: (1 + N, 2)."""
    return _positions(parsed_poses(shown.parsed, shown.end, parsed_scene(shown.parsed, 0)).bodies)


def _positions(bodies: Floats) -> Floats:
    """Of robot and N blocks, (1 + N, 2), from poses (5 + N, 3)."""
    return bodies[[ROBOT, *range(FIRST_BLOCK, len(bodies))], :2]


def _starts_alike(one: ParsedDemonstration, two: ParsedDemonstration) -> bool:
    """Whether two demonstrations started from the same scene."""
    a, b = one.parsed.blocks[0], two.parsed.blocks[0]
    return a.shape == b.shape and bool(np.allclose(a, b, atol=0.02, equal_nan=True))


def _furthest(one: Floats, two: Floats) -> float:
    """The largest distance between positions (K, 2) and others of the same bodies; 0 of none."""
    return float(np.linalg.norm(one - two, axis=1).max(initial=0.0))


def _away_from_last_block(shown: ParsedDemonstration) -> float:
    """How far the robot ended from the last block that it moved; 0 if there is none."""
    if not shown.carries:
        return 0.0
    ends = _ends(shown)
    return _furthest(ends[:1], ends[[1 + shown.carries[-1][0]]])
