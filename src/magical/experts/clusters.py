"""Goals of ClusterColour and ClusterShape: where clusters grow, and which blocks go there.

A block counts when it is less than 1 / sqrt(3) times as far from its own cluster's centroid as
from any other's (appendix A.2.7), so clusters may be loose, and many blocks can stay where they
are. Many choices of one anchor for each cluster are priced at once; the cheapest is refined by
leaving out moves that are not needed and adding those that make room around enclosed blocks.
"""

import math
from collections.abc import Callable

import numpy as np

from magical.experts.goals import Goals, Move, Plan, Style, register_goals
from magical.experts.jumble import Bools, Floats, Jumble
from magical.experts.sight import Sight
from magical.scene import Block

RATIO = 0.22  # of squared distances to own and nearest other centroid that a plan aims at
RANGE = 0.1  # above it, over which a block counts less and less
SETTLED = 0.30  # the same that is good enough to stop; below 1 / 3 counts
LASTING = 0.32  # and to rest once it has stopped
STAY = (0.18, 0.3, 0.5, 0.75)  # units from the anchor within which a block may stay
RING = 0.26  # units from an anchor that has a block to the places beside it
TOUCH = 0.2  # units from the anchor at which a block that is brought there comes to rest, about
TOLERANCE = 0.09  # units
MOVE_TIME = 40.0  # control steps that a move costs besides the way
BROKEN = 120.0  # control steps that a block in the wrong place costs
USELESS = 1000.0  # control steps that a plan costs after which no more blocks count
TASTE = 6.0  # control steps that a demonstrator gives for the place it likes best
ROOM = 0.5  # units around a block brought to its place that are better free of other groups'
CROWDING = 250.0  # control steps, per unit, that their closeness costs
NOW = 0.3  # share of it that a block costs which is to leave that place
WAY = 0.34  # units beside a block's way that are better free
BLOCKED = 250.0  # control steps, per unit, that blocks in the way cost
HABIT = 25.0  # control steps that a new anchor must be better by
CHOICES = 150
CROWDED = 200.0  # control steps that it costs at most
ACCESS = 8.0  # how much worse a block is to grasp than the model of `grasp` says
HOPELESS = 160.0  # control steps that this costs at most
GONE = 0.45  # units from a block at which another leaves it free
FREE = 0.5  # units from all blocks at which a spot is free
EDGE = 0.78  # largest coordinate of an anchor

_TICKS = (-0.7, -0.35, 0.0, 0.35, 0.7)
_SPOTS = np.array([(x, y) for x in _TICKS for y in _TICKS])
_ANGLES = np.arange(12) * (math.pi / 6)


def cluster(sight: Sight, style: Style, plan: Plan, attribute: Callable[[Block], str]) -> Plan:
    """The moves that bring every block to its cluster."""
    jumble = Jumble.of(sight, attribute)
    if _is_settled(jumble, SETTLED if plan.moves else LASTING):
        return Plan()
    anchors, moved = _best(jumble, style, plan)
    waits = np.minimum(ACCESS * jumble.access(np.ones_like(jumble.strange)), HOPELESS).tolist()
    moves = tuple(_move(jumble, anchors, i, waits[i]) for i in np.flatnonzero(moved).tolist())
    return Plan(moves, tuple((x, y) for x, y in anchors.tolist()))


def _is_settled(jumble: Jumble, limit: float = SETTLED) -> bool:
    return jumble.member.shape[1] < 2 or float(jumble.ratios(jumble.at).max()) < limit


def _move(jumble: Jumble, anchors: Floats, block: int, wait: float) -> Move:
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
    return Move((x, y), TOLERANCE, block, wait)


def _best(jumble: Jumble, style: Style, plan: Plan) -> tuple[Floats, Bools]:
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
    return chosen, _refined(jumble, chosen, moved)


def _cheapest(jumble: Jumble, anchors: Floats) -> tuple[Floats, Bools]:
    """The cost of choices of anchors (C, groups, 2) and the moves (C, n) that give it."""
    away = np.linalg.norm(jumble.at - anchors[:, jumble.group], axis=-1)  # (C, n)
    moved = away > np.array(STAY)[:, None, None]  # (stays, C, n)
    cost = np.stack([_cost(jumble, anchors, moves, away) for moves in moved])
    least = cost.argmin(axis=0)
    rows = np.arange(len(anchors))
    return cost[least, rows], moved[least, rows]


def _cost(jumble: Jumble, anchors: Floats, moved: Bools, away: Floats) -> Floats:
    """Control steps, about, for choices of anchors (C, groups, 2) and moves (C, n)."""
    after = _after(jumble, anchors, moved)
    near = _distances(after[..., :, None, :], jumble.at)  # (C, n, n): from new to old places
    time = MOVE_TIME + 11.0 * away + _access(jumble, moved, near)
    broken = _broken(jumble, after)
    tight = np.maximum(0.0, ROOM - _distances(after[..., :, None, :], after[..., None, :, :]))
    # Blocks that are to leave may not have left yet.
    tight += NOW * np.maximum(0.0, ROOM - near)
    blocked = np.maximum(0.0, WAY - _gaps(jumble.at, after))
    crowding = (CROWDING * tight * jumble.strange + BLOCKED * blocked).sum(axis=-1)
    cost: Floats = (moved * (time + np.minimum(crowding, CROWDED))).sum(axis=-1)
    return cost + BROKEN * broken + USELESS * (broken >= _broken(jumble, jumble.at))  # (C,)


def _broken(jumble: Jumble, at: Floats) -> Floats:
    """How many blocks do not count at positions (..., n, 2), the doubtful in part."""
    broken: Floats = np.clip((jumble.ratios(at) - RATIO) / RANGE, 0.0, 1.0).sum(axis=-1)
    return broken


def _access(jumble: Jumble, moved: Bools, near: Floats) -> Floats:
    """What it costs (C, n) to grasp the blocks that move: the most accessible go first."""
    alone = jumble.access(np.ones_like(jumble.strange))
    earlier = alone[:, None] > alone
    before = np.maximum(_distances(jumble.at[:, None], jumble.at) + 0.1, GONE)
    gone = moved[..., None, :] & earlier & (near.swapaxes(-1, -2) > before)
    return np.minimum(ACCESS * jumble.access(~gone), HOPELESS)


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


def _after(jumble: Jumble, anchors: Floats, moved: Bools) -> Floats:
    """Where the blocks are once the moves are made, about."""
    target = anchors[..., jumble.group, :]
    offset = jumble.at - target
    offset *= TOUCH / np.maximum(np.linalg.norm(offset, axis=-1, keepdims=True), TOUCH)
    return np.where(moved[..., None], target + offset, jumble.at)


def _refined(jumble: Jumble, anchors: Floats, moved: Bools) -> Bools:
    """Leave out moves that the result does not need, and add those that make room for others."""
    away = np.linalg.norm(jumble.at - anchors[jumble.group], axis=-1)
    cost = float(_cost(jumble, anchors, moved, away))
    toggle = np.eye(len(moved), dtype=np.bool_)
    while True:
        others = moved ^ toggle  # (n, n)
        costs = _cost(jumble, anchors, others, away)
        least = int(costs.argmin())
        if costs[least] >= cost - 1e-9:
            return moved
        moved, cost = others[least], float(costs[least])


def _options(jumble: Jumble, style: Style, plan: Plan) -> tuple[list[Floats], list[Floats]]:
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
        lambda sight: _is_settled(Jumble.of(sight, attribute)),
    )


register_goals("ClusterColour", _goals(lambda block: block.colour))
register_goals("ClusterShape", _goals(lambda block: block.shape))
