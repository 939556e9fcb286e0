"""How a block at a place relates to the other objects of its scene.

A relation is a number: mostly a distance to the nearest object of some kind, such as the nearest
other block of the same colour. Absolute colours, shapes, directions and (unless a block has no
other object to relate to) positions do not occur, so whatever is learned from relations also holds
for permuted colours and shapes, and for scenes that are mirrored or rotated by quarter turns.
"""

import math
from collections.abc import Callable, Sequence
from functools import cached_property, partial
from typing import NamedTuple

import torch
from torch import Tensor

from magical.scene.vocabulary import COLOURS, SHAPES
from magical_goals.objects.hindsight import ROBOT_TARGET
from magical_goals.objects.table import ObjectTable

UNKNOWN = 9.0  # the value of a relation to something that does not exist
NO_KIND = -5  # the colour and shape of the robot: equal to no block's

SIDE_BY_SIDE = 0.6  # units between the centres of two blocks
LINE_GAP, LINE_OVERLAP = 0.4, 0.2  # units: farthest and nearest neighbours in a line

# Knots of the piecewise linear functions of a relation (see `goals`): a few for the choice of a
# block, more for its destination. Values beyond the last knot are all treated alike, because far
# away only the kind of object should matter; UNKNOWN has its own knot.
EDGE = (
    (-0.12, -0.04, 0.0, 0.05, 0.15),
    (-0.3, -0.25, -0.2, -0.15, -0.1, -0.05, 0.0, 0.03, 0.06, 0.1, 0.15, 0.2, 0.25, 0.3),
)
CONTACT = (
    (0.2, 0.25, 0.3, 0.36, 0.45),
    (0.0, 0.1, 0.15, 0.18, 0.2, 0.22, 0.24, 0.26, 0.28, 0.3, 0.33, 0.36, 0.4, 0.45),
)
GROUP = (
    (0.1, 0.25, 0.4, 0.6, 0.9),
    (0.0, 0.03, 0.06, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.65, 0.8, 1.1, 1.6),
)
LINE = (
    (0.0, 0.06, 0.12, 0.2, 0.3),
    (0.0, 0.02, 0.04, 0.06, 0.08, 0.1, 0.12, 0.14, 0.17, 0.2, 0.23, 0.27, 0.32, 0.4),
)
SHARE = (
    (0.2, 0.3, 0.37, 0.45, 0.6),
    (0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.45, 0.5, 0.6, 0.7, 0.8),
)
WALL = (
    (0.1, 0.15, 0.2, 0.28, 0.35),
    (0.0, 0.03, 0.06, 0.09, 0.12, 0.14, 0.16, 0.18, 0.2, 0.22, 0.24, 0.26, 0.3, 0.35),
)
PLACE = (
    (-1.0, -0.5, 0.0, 0.5, 1.0),
    (-1.0, -0.85, -0.7, -0.55, -0.4, -0.25, -0.1, 0.1, 0.25, 0.4, 0.55, 0.7, 0.85, 1.0),
)


class Relation(NamedTuple):
    """How a number is computed, its knots, and how strongly its functions are penalised.

    The penalties are the prior: for the choice of a block, its region and the blocks of its own
    kind come first; distances to walls and to other kinds come last.
    """

    name: str
    measure: Callable[["_Scene"], Tensor]  # gives (B, K)
    knots: tuple[tuple[float, ...], tuple[float, ...]]
    choice_penalty: float
    destination_penalty: float


class _Scene:
    """A target at K places in each scene, with masks of objects (B, N) or (B, M) and distances.

    Places are the last axis, so that the minimum over objects is taken over whole rows of places.
    """

    def __init__(self, table: ObjectTable, targets: Tensor, places: Tensor) -> None:
        self.table, self.places = table, places
        rows = torch.arange(table.size, device=targets.device)
        robot = targets == ROBOT_TARGET
        block = targets.clamp(min=0)
        self.colour = table.colours[rows, block].masked_fill(robot, NO_KIND)
        self.shape = table.shapes[rows, block].masked_fill(robot, NO_KIND)
        self.now = torch.where(robot[:, None], table.robot[:, :2], table.blocks[rows, block])
        self.others = table.present.clone()
        self.others[rows, block] &= robot
        self.same_colour = table.colours == self.colour[:, None]
        self.same_shape = table.shapes == self.shape[:, None]
        self.regions = table.region_colours >= 0
        self.same_region = table.region_colours == self.colour[:, None]

    @cached_property
    def to_regions(self) -> Tensor:
        """Distances of the places to the regions' edges, (B, M, K)."""
        return _edge_distances(self.places, self.table.regions)

    def region(self, mask: Tensor) -> Tensor:
        """Distances (B, K) of the places to the nearest region in a mask (B, M)."""
        return _nearest(self.to_regions, mask & self.regions)

    @cached_property
    def to_blocks(self) -> Tensor:
        """Distances of the places to the blocks, (B, N, K)."""
        return _distances(self.table.blocks, self.places)

    @cached_property
    def in_region(self) -> Tensor:
        """Which blocks (B, N) lie in a region."""
        inside = _edge_distances(self.table.blocks, self.table.regions) <= 0.0  # (B, M, N)
        return (inside & self.regions[:, :, None]).any(dim=1)

    @cached_property
    def around(self) -> Tensor:
        """Which regions (B, M) the target is in now, give or take 0.02 units."""
        own = _edge_distances(self.now[:, None], self.table.regions)[..., 0]
        return own <= 0.02

    @cached_property
    def line_residuals(self) -> tuple[Tensor, Tensor, Tensor]:
        """How far places are from continuing each pair's line, (B, P, K); valid pairs; lengths.

        A place should also be at a neighbour's distance from one of the two blocks.
        """
        blocks = self.table.blocks
        count = blocks.shape[1]
        first, second = torch.triu_indices(count, count, 1, device=blocks.device)
        start, end = blocks[:, first], blocks[:, second]  # (B, P, 2)
        length = (end - start).norm(dim=2).clamp(min=1e-3)
        direction = (end - start) / length[..., None]
        normal = torch.stack([direction[..., 1], -direction[..., 0]], dim=2)
        along, across = (
            axis @ self.places.transpose(1, 2) - (start * axis).sum(dim=2, keepdim=True)
            for axis in (direction, normal)
        )
        gap = torch.minimum(along.abs(), (along - length[..., None]).abs())
        beyond, within = (gap - LINE_GAP).clamp(min=0.0), (LINE_OVERLAP - gap).clamp(min=0.0)
        residual = (across**2 + beyond**2 + 4.0 * within**2).sqrt()
        return residual, self.others[:, first] & self.others[:, second], length


def relate(
    table: ObjectTable, targets: Tensor, places: Tensor, which: Sequence[int] | None = None
) -> Tensor:
    """The relations that the target of each scene would have at each of K places.

    Args:
        table: B scenes.
        targets: (B,) int64, a block's number or ROBOT_TARGET.
        places: (B, K, 2).
        which: the positions in `RELATIONS` of those to compute; None: all.

    Returns:
        (B, K, R) float32, R the number of relations computed.
    """
    scene = _Scene(table, targets, places)
    chosen = RELATIONS if which is None else [RELATIONS[k] for k in which]
    return torch.stack([relation.measure(scene) for relation in chosen], dim=2)


def _edge_distances(places: Tensor, regions: Tensor) -> Tensor:
    """Distances of places (B, K, 2) to the edges of regions: (B, M, K), negative inside."""
    x, y = (
        (places[:, None, :, axis] - regions[:, :, None, axis]).abs() - regions[:, :, None, 2 + axis]
        for axis in (0, 1)
    )
    return torch.maximum(x, y)


def _distances(objects: Tensor, places: Tensor) -> Tensor:
    """Distances of objects (B, N, 2) to places (B, K, 2): (B, N, K)."""
    return torch.cdist(objects, places, compute_mode="donot_use_mm_for_euclid_dist")


def _nearest(distances: Tensor, mask: Tensor) -> Tensor:
    """The smallest of the distances (B, N, K) to objects in a mask (B, N): (B, K)."""
    return distances.masked_fill(~mask[..., None], UNKNOWN).amin(dim=1)


def _nearest_block(
    scene: _Scene, colour: bool | None, shape: bool | None, in_region: bool | None
) -> Tensor:
    """The distance to the nearest other block; None: with or without that property."""
    mask = scene.others
    for wanted, is_so in ((colour, scene.same_colour), (shape, scene.same_shape)):
        if wanted is not None:
            mask = mask & (is_so == wanted)
    if in_region is not None:
        mask = mask & (scene.in_region == in_region)
    return _nearest(scene.to_blocks, mask)


def _centre_distances(scene: _Scene, masks: Tensor) -> Tensor:
    """Distances (B, G, K) to the mean positions of the blocks of each of G masks (B, G, N)."""
    total = masks.sum(dim=2, keepdim=True)  # (B, G, 1)
    centres = masks.float() @ scene.table.blocks / total.clamp(min=1.0)
    return _distances(centres, scene.places).masked_fill(total == 0, UNKNOWN)


def _line(scene: _Scene, longest: float) -> Tensor:
    """How far places are from continuing a line of two other blocks less than `longest` apart."""
    residual, pairs, length = scene.line_residuals
    return _nearest(residual, pairs & (length < longest))


def _share(scene: _Scene, kinds: Tensor, own: Tensor, count: int) -> Tensor:
    """The distance to the own group's centre, as a share of it plus that to the nearest other."""
    groups = torch.arange(count, device=own.device)
    distances = _centre_distances(
        scene, scene.others[:, None] & (kinds[:, None] == groups[:, None])
    )
    mine = groups == own[:, None]  # (B, count)
    to_own, to_other = _nearest(distances, mine), _nearest(distances, ~mine)
    known = (to_own < UNKNOWN) & (to_other < UNKNOWN)
    return (to_own / (to_own + to_other + 1e-6)).masked_fill(~known, UNKNOWN)


def _coordinate(scene: _Scene, axis: int) -> Tensor:
    """A place's coordinate, if there are no regions and no other blocks."""
    alone = ~scene.regions.any(dim=1) & ~scene.others.any(dim=1)
    return scene.places[..., axis].masked_fill(~alone[:, None], UNKNOWN)


def _block_relation(
    name: str,
    colour: bool | None,
    shape: bool | None,
    in_region: bool | None,
    choice_penalty: float,
    destination_penalty: float,
) -> Relation:
    measure = partial(_nearest_block, colour=colour, shape=shape, in_region=in_region)
    return Relation(name, measure, CONTACT, choice_penalty, destination_penalty)


RELATIONS = (
    Relation("region of the same colour", lambda s: s.region(s.same_region), EDGE, 1.5, 1.5),
    Relation("region of another colour", lambda s: s.region(~s.same_region), EDGE, 1.5, 1.5),
    Relation("any region", lambda s: s.region(s.regions), EDGE, 1, 1),
    _block_relation("block of the same colour and shape, in a region", True, True, True, 2, 2),
    _block_relation("block of the same colour and shape, in none", True, True, False, 2, 2),
    _block_relation("block of the same colour alone, in a region", True, False, True, 2, 2),
    _block_relation("block of the same colour alone, in none", True, False, False, 2, 2),
    _block_relation("block of the same shape alone, in a region", False, True, True, 2, 2),
    _block_relation("block of the same shape alone, in none", False, True, False, 2, 2),
    _block_relation("block of another colour and shape, in a region", False, False, True, 8, 4),
    _block_relation("block of another colour and shape, in none", False, False, False, 8, 4),
    Relation(
        "centre of the other blocks of the same colour",
        lambda s: _centre_distances(s, (s.others & s.same_colour)[:, None])[:, 0],
        GROUP,
        4,
        2,
    ),
    Relation(
        "centre of the other blocks of the same shape",
        lambda s: _centre_distances(s, (s.others & s.same_shape)[:, None])[:, 0],
        GROUP,
        4,
        2,
    ),
    _block_relation("block of another colour", False, None, None, 8, 4),
    _block_relation("block of another shape", None, False, None, 8, 4),
    _block_relation("any other block", None, None, None, 8, 2),
    Relation("line of two other blocks", partial(_line, longest=math.inf), LINE, 4, 3),
    Relation(
        "line of two other blocks side by side", partial(_line, longest=SIDE_BY_SIDE), LINE, 8, 2
    ),
    Relation(
        "share of the own colour's distance",
        lambda s: _share(s, s.table.colours, s.colour, len(COLOURS)),
        SHARE,
        4,
        2,
    ),
    Relation(
        "share of the own shape's distance",
        lambda s: _share(s, s.table.shapes, s.shape, len(SHAPES)),
        SHARE,
        4,
        2,
    ),
    Relation("wall", lambda s: 1.0 - s.places.abs().amax(dim=2), WALL, 8, 2),
    Relation("x, where there is nothing else", partial(_coordinate, axis=0), PLACE, 1, 1),
    Relation("y, where there is nothing else", partial(_coordinate, axis=1), PLACE, 1, 1),
    Relation("region that it is in now", lambda s: s.region(s.around), EDGE, 1, 1),
)
