"""Goals of ClusterColour and ClusterShape: where clusters grow, and which blocks go there.

A block counts when it is less than 1 / sqrt(3) times as far from its own cluster's centroid as
from any other's (appendix A.2.7), so clusters may be loose, and many blocks can stay where they
are. Many choices of one anchor for each cluster are priced at once; the cheapest is refined by
leaving out moves that are not needed.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from magical.experts.goals import Goals, Move, Plan, Style, register_goals
from magical.experts.sight import Sight
from magical.scene import Block

Floats = NDArray[np.float64]
Ints = NDArray[np.intp]

RATIO = 0.22  # of squared distances to own and nearest other centroid that a plan aims at
RANGE = 0.1  # above it, over which a block counts less and less
SETTLED = 0.30  # the same that is good enough to stop; below 1 / 3 counts
STAY = (0.18, 0.3, 0.5, 0.75)  # units from the anchor within which a block may stay
RING = 0.26  # units from an anchor that has a block to the places beside it
TOUCH = 0.2  # units from the anchor at which a block that is brought there comes to rest, about
TOLERANCE = 0.09  # units
MOVE_TIME = 40.0  # control steps that a move costs besides the way
BROKEN = 120.0  # control steps that a block in the wrong place costs
NOTHING = 1000.0  # control steps that it costs to leave an unsolved jumble as it is
TASTE = 6.0  # control steps that a demonstrator gives for the place it likes best
ROOM = 0.5  # units around a block brought to its place that are better free of other groups'
CROWDING = 250.0  # control steps, per unit, that their closeness costs
NOW = 0.3  # share of it that a block costs which is to leave that place
WAY = 0.34  # units beside a block's way that are better free
BLOCKED = 250.0  # control steps, per unit, that blocks in the way cost
HABIT = 25.0  # control steps that a new anchor must be better by
CHOICES = 150
NEIGHBOUR, ACCESS = 0.4, 250.0  # units within which a neighbour costs how many steps per unit
FREE = 0.5  # units from all blocks at which a spot is free
EDGE = 0.78  # largest coordinate of an anchor

_TICKS = (-0.7, -0.35, 0.0, 0.35, 0.7)
_SPOTS = np.array([(x, y) for x in _TICKS for y in _TICKS])
_ANGLES = np.arange(12) * (math.pi / 6)


@dataclass(frozen=True, slots=True)
class _Jumble:
    """The blocks as arrays."""

    at: Floats  # (n, 2)
    group: Ints  # (n,)
    member: Floats  # (n, groups) one-hot
    strange: NDArray[np.bool_]  # (n, n) of different groups
    access: Floats  # (n,) control steps that close neighbours cost who wants to grasp a block

    @staticmethod
    def of(sight: Sight, attribute: Callable[[Block], str]) -> "_Jumble":
        values = [attribute(block) for block in sight.scene.blocks]
        present = sorted(set(values))
        group = np.array([present.index(value) for value in values])
        at = np.array(sight.resting)
        gaps = np.linalg.norm(at[:, None] - at, axis=-1) + np.eye(len(at))
        access = ACCESS * np.maximum(0.0, NEIGHBOUR - gaps).sum(axis=1)
        strange = group[:, None] != group
        return _Jumble(at, group, np.eye(len(present))[group], strange, access)

    def ratios(self, at: Floats) -> Floats:
        """Own over nearest other squared distance to a centroid, for positions (..., n, 2)."""
        centroids = self.member.T @ at / self.member.sum(axis=0)[:, None]  # (..., groups, 2)
        squared = np.square(at[..., :, None, :] - centroids[..., None, :, :]).sum(axis=-1)
        own = (squared * self.member).sum(axis=-1)
        other = np.where(self.member > 0, np.inf, squared).min(axis=-1)
        ratios: Floats = own / np.maximum(other, 1e-6)
        return ratios  # (..., n)


def cluster(sight: Sight, style: Style, plan: Plan, attribute: Callable[[Block], str]) -> Plan:
    """The moves that bring every block to its cluster."""
    jumble = _Jumble.of(sight, attribute)
    if _is_settled(jumble):
        return Plan()
    anchors, moved = _best(jumble, style, plan)
    moves = tuple(_move(jumble, anchors, moved, i) for i in np.flatnonzero(moved).tolist())
    return Plan(moves, tuple((x, y) for x, y in anchors.tolist()))


def _is_settled(jumble: _Jumble) -> bool:
    return jumble.member.shape[1] < 2 or float(jumble.ratios(jumble.at).max()) < SETTLED


def _move(jumble: _Jumble, anchors: Floats, moved: NDArray[np.bool_], block: int) -> Move:
    """Bring a block to its anchor, or beside the blocks of its group that are there already."""
    at, anchor = jumble.at[block], anchors[jumble.group[block]]
    ring = anchor + RING * np.stack((np.cos(_ANGLES), np.sin(_ANGLES)), axis=-1)  # (A, 2)
    places = np.concatenate((anchor[None], ring))
    others = np.delete(jumble.at, block, axis=0)
    room = np.linalg.norm(places[:, None] - others, axis=-1)  # (A + 1, n - 1)
    cost = 10.0 * np.linalg.norm(places - at, axis=-1) + 20.0 * (np.abs(places).max(axis=1) > 0.85)
    cost += 150.0 * np.maximum(0.0, RING - 0.01 - room).sum(axis=1)
    cost[1:] += 10.0 * RING
    x, y = places[cost.argmin()].tolist()
    return Move((x, y), TOLERANCE, block)


def _best(jumble: _Jumble, style: Style, plan: Plan) -> tuple[Floats, NDArray[np.bool_]]:
    """Anchors (groups, 2), and which blocks move there (n,)."""
    options, tastes = _options(jumble, style, plan)
    rng = np.random.default_rng(int(style.places[-1] * 2**31))
    picks = np.stack([rng.integers(len(spots), size=CHOICES) for spots in options], axis=1)
    best, moved = picks[0], np.zeros(len(jumble.at), dtype=np.bool_)
    for group in (None, *range(len(options)), *range(len(options))):
        if group is not None:  # all anchors of one cluster, the others' kept
            picks = np.repeat(best[None], len(options[group]), axis=0)
            picks[:, group] = np.arange(len(options[group]))
        anchors = np.stack([spots[i] for spots, i in zip(options, picks.T, strict=True)], axis=1)
        taste = sum(likes[i] for likes, i in zip(tastes, picks.T, strict=True))
        cost, moves = _cheapest(jumble, anchors)
        least = int((cost + taste).argmin())
        best, moved = picks[least], moves[least]
    chosen = np.array([spots[i] for spots, i in zip(options, best, strict=True)])
    return chosen, _without_needless(jumble, chosen, moved)


def _cheapest(jumble: _Jumble, anchors: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """The cost of choices of anchors (C, groups, 2) and the moves (C, n) that give it."""
    away = np.linalg.norm(jumble.at - anchors[:, jumble.group], axis=-1)  # (C, n)
    moved = away > np.array(STAY)[:, None, None]  # (stays, C, n)
    cost = np.stack([_cost(jumble, anchors, moves, away) for moves in moved])
    least = cost.argmin(axis=0)
    rows = np.arange(len(anchors))
    return cost[least, rows], moved[least, rows]


def _cost(jumble: _Jumble, anchors: Floats, moved: NDArray[np.bool_], away: Floats) -> Floats:
    """Control steps, about, for choices of anchors (C, groups, 2) and moves (C, n)."""
    time = (moved * (MOVE_TIME + 11.0 * away + jumble.access)).sum(axis=-1)
    after = _after(jumble, anchors, moved)
    broken = np.clip((jumble.ratios(after) - RATIO) / RANGE, 0.0, 1.0).sum(axis=-1)
    tight = np.maximum(0.0, ROOM - _distances(after[..., :, None, :], after[..., None, :, :]))
    # Blocks that are to leave may not have left yet.
    tight += NOW * np.maximum(0.0, ROOM - _distances(after[..., :, None, :], jumble.at))
    blocked = np.maximum(0.0, WAY - _gaps(jumble.at, after))
    crowding = ((CROWDING * tight * jumble.strange + BLOCKED * blocked).sum(axis=-1) * moved).sum(
        -1
    )
    cost: Floats = time + BROKEN * broken + crowding
    return cost + NOTHING * ~moved.any(axis=-1)  # (C,)


def _distances(a: Floats, b: Floats) -> Floats:
    offset = a - b
    distances: Floats = np.sqrt(offset[..., 0] ** 2 + offset[..., 1] ** 2)
    return distances


def _gaps(at: Floats, after: Floats) -> Floats:
    """How close the straight way of each block to `after` (..., n, 2) passes the blocks `at`.

    Returns (..., n, n); a block is no obstacle to itself, nor one that it starts beside.
    """
    way = after - at  # (..., n, 2)
    square = np.maximum((way * way).sum(axis=-1), 1e-9)[..., None]
    to = at - at[:, None]  # (n, n, 2): from row to column
    along = ((to * way[..., :, None, :]).sum(axis=-1) / square).clip(0.0, 1.0)  # (..., n, n)
    near = _distances(to, along[..., None] * way[..., :, None, :])
    gaps: Floats = np.where(along > 0.0, near, np.inf)
    return gaps


def _after(jumble: _Jumble, anchors: Floats, moved: NDArray[np.bool_]) -> Floats:
    """Where the blocks are once the moves are made, about."""
    target = anchors[..., jumble.group, :]
    offset = jumble.at - target
    offset *= TOUCH / np.maximum(np.linalg.norm(offset, axis=-1, keepdims=True), TOUCH)
    return np.where(moved[..., None], target + offset, jumble.at)


def _without_needless(
    jumble: _Jumble, anchors: Floats, moved: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Leave out the moves that the result does not need, the furthest first."""
    away = np.linalg.norm(jumble.at - anchors[jumble.group], axis=-1)
    moved = moved.copy()
    cost = float(_cost(jumble, anchors, moved, away))
    for block in sorted(np.flatnonzero(moved).tolist(), key=lambda i: -float(away[i])):
        moved[block] = False
        cheaper = float(_cost(jumble, anchors, moved, away))
        if cheaper < cost:
            cost = cheaper
        else:
            moved[block] = True
    return moved


def _options(jumble: _Jumble, style: Style, plan: Plan) -> tuple[list[Floats], list[Floats]]:
    """Each group's anchors (M, 2) to choose from, and how little the demonstrator likes each."""
    groups = jumble.member.shape[1]
    room = np.linalg.norm(_SPOTS[:, None] - jumble.at, axis=-1).min(axis=1)  # (spots,)
    free = _SPOTS[room > FREE]
    options, tastes = [], []
    for group in range(groups):
        own = jumble.at[jumble.group == group]
        kept = [plan.places[group]] if len(plan.places) == groups else []
        spots = np.concatenate((own, own.mean(axis=0)[None], np.array(kept).reshape(-1, 2), free))
        spots = spots.clip(-EDGE, EDGE)
        bins = np.floor((spots + 1.0) * 1.5).astype(np.intp).clip(0, 2)  # thirds of the workspace
        liking = np.array(style.places[:36]).reshape(4, 3, 3)[group % 4]
        options.append(spots)
        taste = TASTE * liking[bins[:, 0], bins[:, 1]]
        if kept:
            taste[len(own) + 1] -= HABIT
        tastes.append(taste)
    return options, tastes


def _goals(attribute: Callable[[Block], str]) -> Goals:
    return Goals(
        lambda sight, style, plan: cluster(sight, style, plan, attribute),
        lambda sight: _is_settled(_Jumble.of(sight, attribute)),
    )


register_goals("ClusterColour", _goals(lambda block: block.colour))
register_goals("ClusterShape", _goals(lambda block: block.shape))
