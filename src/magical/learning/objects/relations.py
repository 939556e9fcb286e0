"""How a block, at a place, relates to the other objects of its scene.

A relation is a number: mostly a distance to the nearest object of some kind, such as the nearest
other block of the same colour. Absolute colours, shapes, directions and (unless a block has no
other object to relate to) positions do not occur, so whatever is learned from relations is the same
for permuted colours and shapes, and for scenes that are turned or mirrored.
"""

from collections.abc import Iterator
from typing import NamedTuple

import torch
from torch import Tensor

from magical.learning.objects.hindsight import ROBOT_TARGET
from magical.learning.objects.table import ObjectTable
from magical.scene.vocabulary import COLOURS, SHAPES

UNKNOWN = 9.0  # the value of a relation to something that is not there
NO_KIND = -5  # the colour and shape of the robot: like those of no block

# Knots of the piecewise linear functions of a relation (see `goals`): a few for the choice of a
# block, more for its destination. Values beyond the last are all alike, because far away only
# the kind of object should matter; UNKNOWN has a knot of its own.
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
    """A relation's knots, and how strongly its functions are held at 0.

    The penalties are the prior: for the choice of a block, which region and which of its own kind
    it is with comes first, distances to walls and to other kinds come last.
    """

    name: str
    knots: tuple[tuple[float, ...], tuple[float, ...]]
    choice_penalty: float
    destination_penalty: float


RELATIONS = (
    Relation("region of the same colour", EDGE, 1.5, 1.5),
    Relation("region of another colour", EDGE, 1.5, 1.5),
    Relation("any region", EDGE, 1, 1),
    Relation("block of the same colour and shape, in a region", CONTACT, 2, 2),
    Relation("block of the same colour and shape, in none", CONTACT, 2, 2),
    Relation("block of the same colour alone, in a region", CONTACT, 2, 2),
    Relation("block of the same colour alone, in none", CONTACT, 2, 2),
    Relation("block of the same shape alone, in a region", CONTACT, 2, 2),
    Relation("block of the same shape alone, in none", CONTACT, 2, 2),
    Relation("block of another colour and shape, in a region", CONTACT, 8, 4),
    Relation("block of another colour and shape, in none", CONTACT, 8, 4),
    Relation("centre of the other blocks of the same colour", GROUP, 4, 2),
    Relation("centre of the other blocks of the same shape", GROUP, 4, 2),
    Relation("block of another colour", CONTACT, 8, 4),
    Relation("block of another shape", CONTACT, 8, 4),
    Relation("any other block", CONTACT, 8, 2),
    Relation("line of two other blocks", LINE, 4, 3),
    Relation("line of two other blocks side by side", LINE, 8, 2),
    Relation("share of the own colour's distance", SHARE, 4, 2),
    Relation("share of the own shape's distance", SHARE, 4, 2),
    Relation("wall", WALL, 8, 2),
    Relation("x, where there is nothing else", PLACE, 1, 1),
    Relation("y, where there is nothing else", PLACE, 1, 1),
    Relation("region that it is in now", EDGE, 1, 1),
)

SIDE_BY_SIDE = 0.6  # units between the centres of two blocks
LINE_GAP, LINE_OVERLAP = 0.4, 0.2  # units: neighbours in a line are not farther, nor nearer


def relate(table: ObjectTable, targets: Tensor, places: Tensor) -> Tensor:
    """The relations of a target in each scene, if it were at each of K places.

    Args:
        table: B scenes.
        targets: (B,) int64, a block's number or ROBOT_TARGET.
        places: (B, K, 2).

    Returns:
        (B, K, R) float32, R the number of `RELATIONS`.
    """
    scene = _Scene(table, targets)
    to_regions = _edge_distances(places, table.regions)  # (B, K, M)
    to_blocks = torch.cdist(places, table.blocks)  # (B, K, N)
    values = [
        *_region_relations(scene, to_regions),
        *_block_relations(scene, places, to_blocks),
        *_line_relations(scene, places),
        *_share_relations(scene, places),
        1.0 - places.abs().amax(dim=2),
        *(places[..., k].masked_fill(~scene.alone[:, None], UNKNOWN) for k in (0, 1)),
        _nearest(to_regions, scene.around),
    ]
    return torch.stack(values, dim=2)


class _Scene:
    """Which objects of each scene are of which kind for its target; masks (B, N) or (B, M)."""

    def __init__(self, table: ObjectTable, targets: Tensor) -> None:
        self.table = table
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
        inside = _edge_distances(table.blocks, table.regions) <= 0.0  # (B, N, M)
        self.in_region = (inside & self.regions[:, None]).any(dim=2)
        own = _edge_distances(self.now[:, None], table.regions)[:, 0]
        self.around = (own <= 0.02) & self.regions
        self.alone = ~self.regions.any(dim=1) & ~self.others.any(dim=1)


def _edge_distances(places: Tensor, regions: Tensor) -> Tensor:
    """Distances of places (B, K, 2) to the edges of regions: (B, K, M), negative inside."""
    apart = (places[:, :, None] - regions[:, None, :, :2]).abs() - regions[:, None, :, 2:]
    return apart.amax(dim=3)


def _nearest(distances: Tensor, mask: Tensor) -> Tensor:
    """The least of the distances (B, K, N) to objects of a mask (B, N): (B, K)."""
    return distances.masked_fill(~mask[:, None], UNKNOWN).amin(dim=2)


def _region_relations(scene: _Scene, distances: Tensor) -> Iterator[Tensor]:
    for mask in (scene.same_region, ~scene.same_region, scene.regions):
        yield _nearest(distances, mask & scene.regions)


def _block_relations(scene: _Scene, places: Tensor, distances: Tensor) -> Iterator[Tensor]:
    colour, shape, others = scene.same_colour, scene.same_shape, scene.others
    for kind in (colour & shape, colour & ~shape, ~colour & shape, ~colour & ~shape):
        yield _nearest(distances, others & kind & scene.in_region)
        yield _nearest(distances, others & kind & ~scene.in_region)
    for kind in (colour, shape):
        yield _centre_distances(scene, places, others & kind)
    yield _nearest(distances, others & ~colour)
    yield _nearest(distances, others & ~shape)
    yield _nearest(distances, others)


def _centre_distances(scene: _Scene, places: Tensor, mask: Tensor) -> Tensor:
    """Distances (B, K) to the mean position of a mask's blocks."""
    weights = mask.float()
    blocks = scene.table.blocks
    total = weights.sum(dim=1)
    centre = (blocks * weights[..., None]).sum(dim=1) / total.clamp(min=1.0)[:, None]
    distances: Tensor = (places - centre[:, None]).norm(dim=2)
    return distances.masked_fill((total == 0)[:, None], UNKNOWN)


def _line_relations(scene: _Scene, places: Tensor) -> Iterator[Tensor]:
    """How far a place is from continuing a line of two other blocks, at a neighbour's distance."""
    blocks = scene.table.blocks
    count = blocks.shape[1]
    first, second = torch.triu_indices(count, count, 1, device=blocks.device)
    start, end = blocks[:, first], blocks[:, second]  # (B, P, 2)
    pairs = scene.others[:, first] & scene.others[:, second]
    length = (end - start).norm(dim=2).clamp(min=1e-3)
    direction = (end - start) / length[..., None]
    offset = places[:, :, None] - start[:, None]  # (B, K, P, 2)
    along = (offset * direction[:, None]).sum(dim=3)
    across = offset[..., 0] * direction[:, None, :, 1] - offset[..., 1] * direction[:, None, :, 0]
    gap = torch.minimum(along.abs(), (along - length[:, None]).abs())
    beyond, within = (gap - LINE_GAP).clamp(min=0.0), (LINE_OVERLAP - gap).clamp(min=0.0)
    residual = (across**2 + beyond**2 + 4.0 * within**2).sqrt()
    yield _nearest(residual, pairs)
    yield _nearest(residual, pairs & (length < SIDE_BY_SIDE))


def _share_relations(scene: _Scene, places: Tensor) -> Iterator[Tensor]:
    """The distance to the own group's centre, as a share of it and the nearest other group's."""
    table = scene.table
    groups = (
        (table.colours, scene.colour, len(COLOURS)),
        (table.shapes, scene.shape, len(SHAPES)),
    )
    for kinds, own, count in groups:
        masks = [scene.others & (kinds == k) for k in range(count)]
        distances = torch.stack([_centre_distances(scene, places, m) for m in masks], dim=2)
        mine = torch.arange(count, device=own.device) == own[:, None]  # (B, count)
        to_own, to_other = _nearest(distances, mine), _nearest(distances, ~mine)
        known = (to_own < UNKNOWN) & (to_other < UNKNOWN)
        share = to_own / (to_own + to_other + 1e-6)
        yield share.masked_fill(~known, UNKNOWN)
