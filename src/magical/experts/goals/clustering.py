"""Goals of ClusterColour and ClusterShape: where clusters grow, and which blocks move there.

Clusters may be loose (appendix A.2.7), so many blocks can stay where they are. A plan consists of
one anchor for each cluster, and of the blocks that move to their anchors. Many choices of anchors
are priced at once; the cheapest is refined by removing moves that are not needed and adding moves
that make room around enclosed blocks.
"""

import math
from collections.abc import Callable
from functools import cached_property

import numpy as np

from magical.experts import geometry as g
from magical.experts.geometry import Bools, Floats, Ints
from magical.experts.goals.regions import DISTANCE_COST, MOVE_COST, place_costs
from magical.experts.grasp import Grasps, make_mutual_grasps
from magical.experts.planning import Move, MovePlan, Planner, Strategy
from magical.experts.state_view import StateView
from magical.scene import Block, lengths
from magical.tasks.scoring import centroid_distances

# When blocks count as clustered, and which anchors are considered.
PLANNED_RATIO = 0.22  # of squared centroid distances that a plan aims for; tuned
RATIO_RANGE = 0.1  # above it, over which a block counts less and less; tuned
SOLVED_RATIO = 0.30  # good enough to stop; the score requires less than 1 / 3
LASTING_RATIO = 0.32  # good enough not to start again; the score requires less than 1 / 3
STAY = (0.18, 0.3, 0.5, 0.75)  # units from the anchor to blocks that stay
REST = 0.2  # units: approximate distance from the anchor at which a moved block rests; tuned
GRID = (-0.7, -0.35, 0.0, 0.35, 0.7)  # units: coordinates of free anchors
ANCHOR_LIMIT = 0.78  # units: largest coordinate of an anchor; tuned
CHOICES = 150  # joint choices of all anchors, sampled and priced at once; for time
RING_PLACES = 12  # places around an anchor that is occupied; for time
TOLERANCE = 0.09  # units, of a move; tuned
SEPARATION = 0.5  # units between blocks of different groups; swept

# Costs of a plan in addition to its moves, in control steps.
MISPLACED_COST = 120.0  # per block that would not count; tuned
USELESS_COST = 1000.0  # for a plan after which no more blocks count than before; tuned
CROWDING_COST = 250.0  # per unit of missing separation; swept
LEAVING_SHARE = 0.3  # times `CROWDING_COST`, for a block that is to leave the place; swept
BLOCKED_COST = 250.0  # per unit of missing room along a block's way; swept
MAX_CROWDING = 200.0  # at most, for crowding and blocked ways per block; tuned
ACCESS_FACTOR = 8.0  # times the grasp's cost: enclosed blocks are hardly ever grasped; tuned
MAX_ACCESS = 160.0  # at most, for access per block; tuned
PREFERENCE = 6.0  # between the most and the least preferred place; tuned
SWITCH_COST = 25.0  # by which a new anchor must be better; tuned

_GRID = np.array([(x, y) for x in GRID for y in GRID])  # (anchors, 2)
_ANGLES = 2 * math.pi * np.arange(RING_PLACES) / RING_PLACES
_RING = g.BLOCK_SPACING * np.stack((np.cos(_ANGLES), np.sin(_ANGLES)), axis=-1)  # (ring places, 2)


ValueFn = Callable[[Block], str]


def cluster_planner(value_of: ValueFn) -> Planner:
    """The planner of a task that clusters blocks by a value, such as their colour."""

    def plan(view: StateView, strategy: Strategy, last: MovePlan) -> MovePlan:
        layout = Layout(view, value_of)
        if layout.is_clustered(SOLVED_RATIO if last.moves else LASTING_RATIO):
            return MovePlan()
        anchors, moved = _best(layout, strategy, last)
        waits = np.minimum(ACCESS_FACTOR * layout.grasp_costs, MAX_ACCESS).tolist()
        moves = [_move(layout, anchors, i, waits[i]) for i in np.flatnonzero(moved).tolist()]
        return MovePlan(tuple(moves), tuple((x, y) for x, y in anchors.tolist()))

    def is_solved(view: StateView) -> bool:
        return Layout(view, value_of).is_clustered(SOLVED_RATIO)

    return Planner(plan, is_solved)


def _move(layout: "Layout", anchors: Floats, block: int, wait: float) -> Move:
    """Bring a block to its anchor, or next to it if other blocks are there already."""
    anchor, others = anchors[layout.group[block]], np.delete(layout.positions, block, axis=0)
    places = np.concatenate((anchor[None], anchor + _RING))  # (1 + ring places, 2)
    x, y = layout.positions[block]
    cost = place_costs(places, (x, y), others)
    cost[1:] += DISTANCE_COST * g.BLOCK_SPACING
    x, y = places[cost.argmin()].tolist()
    return Move((x, y), TOLERANCE, block, wait)


def _best(layout: "Layout", strategy: Strategy, last: MovePlan) -> tuple[Floats, Bools]:
    """Anchors (groups, 2), and which blocks move there (n,).

    Choices of all anchors are sampled first; then each cluster's anchor is improved in turn.
    """
    options, preferences = _anchor_options(layout, strategy, last)
    rng = np.random.default_rng(int(strategy.placements[-1] * 2**31))
    picks = np.stack([rng.integers(len(own), size=CHOICES) for own in options], axis=1)
    best = picks[0]
    for group in (None, *range(len(options)), *range(len(options))):
        if group is not None:  # all anchors of one cluster, with the others fixed
            picks = np.repeat(best[None], len(options[group]), axis=0)
            picks[:, group] = np.arange(len(options[group]))
        anchors = np.stack([own[i] for own, i in zip(options, picks.T, strict=True)], axis=1)
        cost, moves = layout.cheapest_moves(anchors)
        for own, i in zip(preferences, picks.T, strict=True):
            cost += own[i]
        least = int(cost.argmin())
        best, chosen, moved = picks[least], anchors[least], moves[least]
    return chosen, layout.refine(chosen, moved)


def _anchor_options(
    layout: "Layout", strategy: Strategy, last: MovePlan
) -> tuple[list[Floats], list[Floats]]:
    """Each group's possible anchors (M, 2), and their preference costs (M,) in control steps.

    They are the group's blocks, their centroid, the last plan's anchor, and free grid points. The
    strategy has a preference for each group (modulo 4) and each ninth of the workspace.
    """
    distances = lengths(_GRID[:, None] - layout.positions)  # (grid points, n)
    free = _GRID[distances.min(axis=1) > SEPARATION]
    table = np.array(strategy.placements[:36]).reshape(4, 3, 3)
    options, preferences = [], []
    for group in range(layout.groups):
        own = layout.positions[layout.group == group]
        kept = [last.places[group]] if len(last.places) == layout.groups else []
        anchors = np.concatenate((own, [own.mean(axis=0)], np.reshape(kept, (-1, 2)), free))
        anchors = anchors.clip(-ANCHOR_LIMIT, ANCHOR_LIMIT)
        column, row = np.floor((anchors + 1.0) * 1.5).astype(np.intp).clip(0, 2).T
        cost = PREFERENCE * table[group % 4, column, row]
        if kept:
            cost[len(own) + 1] -= SWITCH_COST
        options.append(anchors)
        preferences.append(cost)
    return options, preferences


class Layout:
    """Where n blocks come to rest, and what plans for them cost.

    Plans are C choices of anchors (C, groups, 2) and moves (C, n).

    Attributes:
        positions: (n, 2).
        values: each block's value of the clustered attribute.
        group: (n,) index of the block's group, the blocks of one value.
        groups: the number of groups.
    """

    def __init__(self, view: StateView, value_of: ValueFn) -> None:
        self.values = list(map(value_of, view.scene.blocks))
        self.positions = np.array(view.resting_blocks)
        self.group: Ints = np.unique(self.values, return_inverse=True)[1]
        self.groups = len(set(self.values))

    def is_clustered(self, limit: float) -> bool:
        """Whether all ratios of distances are below a limit, or there are fewer than two groups."""
        return self.groups < 2 or bool(self._ratios(self.positions).max() < limit)

    def _ratios(self, positions: Floats) -> Floats:
        """Ratios (..., n) of squared distances to own and nearest other centroid, at (..., n, 2).

        A block counts as correctly clustered below 1 / 3 (appendix A.2.7).
        """
        own, other = centroid_distances(self.values, positions)
        ratios: Floats = own / np.maximum(other, 1e-6)
        return ratios

    @cached_property
    def _grasps(self) -> Grasps:
        return make_mutual_grasps(self.positions)

    @cached_property
    def grasp_costs(self) -> Floats:
        """Control steps (n,) that grasping each block costs among all others."""
        costs = self._grasps.wall_costs + self._grasps.block_costs.sum(axis=-1)
        least: Floats = costs.min(axis=1)
        return least

    @cached_property
    def rank(self) -> Ints:
        """Each block's rank (n,) in ascending order of `grasp_costs`."""
        # Two blocks that hinder each other cost the same up to rounding, which must not decide.
        return self.grasp_costs.round(6).argsort(kind="stable").argsort()

    def cheapest_moves(self, anchors: Floats) -> tuple[Floats, Bools]:
        """The cost (C,) of each choice of anchors, and the moves (C, n) that give it."""
        away = self._distances_to_anchors(anchors)
        moved = away > np.array(STAY)[:, None, None]  # (stays, C, n)
        cost = np.stack([self._cost(anchors, moves, away) for moves in moved])
        least, rows = cost.argmin(axis=0), np.arange(len(anchors))
        return cost[least, rows], moved[least, rows]

    def refine(self, anchors: Floats, moved: Bools) -> Bools:
        """Remove or add single moves (n,) as long as that makes the plan cheaper."""
        away = self._distances_to_anchors(anchors)
        cost = float(self._cost(anchors, moved, away))
        toggle = np.eye(len(moved), dtype=np.bool_)
        while True:
            others = moved ^ toggle  # (n, n)
            costs = self._cost(anchors, others, away)
            least = int(costs.argmin())
            if costs[least] >= cost - 1e-9:
                return moved
            moved, cost = others[least], float(costs[least])

    def _distances_to_anchors(self, anchors: Floats) -> Floats:
        """Each block's distance (C, n) to its group's anchor."""
        return lengths(self.positions - anchors[..., self.group, :])

    def _cost(self, anchors: Floats, moved: Bools, away: Floats) -> Floats:
        """Approximate control steps (C,) that plans take, plus the costs of misplaced blocks."""
        before, after = self.positions, self._positions_after(anchors, moved)
        near = lengths(after[..., :, None, :] - before)  # (C, n, n) from new to old positions
        time = MOVE_COST + DISTANCE_COST * away + self._access_cost(moved, near)
        crowding = np.minimum(self._crowding(after, near), MAX_CROWDING)
        misplaced = self._misplaced(after)
        cost: Floats = (moved * (time + crowding)).sum(axis=-1) + MISPLACED_COST * misplaced
        return cost + USELESS_COST * (misplaced >= self._misplaced(before))

    def _positions_after(self, anchors: Floats, moved: Bools) -> Floats:
        """Approximate positions (C, n, 2) of the blocks once the moves are made."""
        target = anchors[..., self.group, :]
        offset = self.positions - target
        offset *= REST / np.maximum(lengths(offset), REST)[..., None]
        return np.where(moved[..., None], target + offset, self.positions)

    def _misplaced(self, positions: Floats) -> Floats:
        """How many blocks (...) do not count at positions (..., n, 2), doubtful ones in part."""
        doubt = (self._ratios(positions) - PLANNED_RATIO) / RATIO_RANGE
        misplaced: Floats = doubt.clip(0.0, 1.0).sum(axis=-1)
        return misplaced

    def _access_cost(self, moved: Bools, near: Floats) -> Floats:
        """Costs (C, n) of grasping the blocks that move, the most accessible first."""
        earlier = self.rank[:, None] > self.rank
        apart = lengths(self.positions[:, None] - self.positions)
        least = np.maximum(apart + 0.1, g.WORKING_DISTANCE)
        gone = moved[..., None, :] & earlier & (near.swapaxes(-1, -2) > least)
        return np.minimum(ACCESS_FACTOR * self.grasp_costs_among(~gone), MAX_ACCESS)

    def grasp_costs_among(self, others: Bools) -> Floats:
        """Grasp costs (..., n), in control steps, with only `others` (..., n, n) around."""
        blocks = self._grasps.block_costs @ others[..., None].astype(np.float64)
        cost: Floats = (self._grasps.wall_costs + blocks[..., 0]).min(axis=-1)
        return cost

    def _crowding(self, after: Floats, near: Floats) -> Floats:
        """Costs (C, n) of other groups' blocks at each block's new place, and of any on its way."""
        apart = lengths(after[..., :, None, :] - after[..., None, :, :])
        missing = np.maximum(0.0, SEPARATION - apart)
        # Blocks that are to leave may not have left yet.
        missing += LEAVING_SHARE * np.maximum(0.0, SEPARATION - near)
        before, group = self.positions, self.group
        share, gap = g.project_on_segments(before[:, None], after[..., :, None, :], before)
        # A block does not obstruct itself, nor one that moves off from next to it.
        narrow = np.where(share > 0.0, np.maximum(0.0, g.DRIVING_CLEARANCE - gap), 0.0)
        crowding = CROWDING_COST * missing * (group[:, None] != group) + BLOCKED_COST * narrow
        total: Floats = crowding.sum(axis=-1)
        return total
