"""Fast overlap tests between bodies: circles first, exact pieces only where needed.

Placement by rejection (docs/specification.md, section 8) runs hundreds of overlap tests per
scene. Results equal those of `geometry.penetrates` on the exact pieces, the slow reference in the
tests.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache, cached_property
from typing import NamedTuple

from magical.scene import constants as c
from magical.scene import geometry as g
from magical.scene.scene import Block, Pose, Region
from magical.scene.vocabulary import Shape


class Silhouette(NamedTuple):
    """A body's outline in its own frame, with circles around its origin and around each piece."""

    pieces: tuple[g.Piece, ...]
    circles: tuple[tuple[g.Point, float], ...]  # centre and radius around each piece
    inner: float  # radius of a circle wholly inside the body
    outer: float  # radius of a circle wholly around the body


def _silhouette(pieces: tuple[g.Piece, ...], inner: float) -> Silhouette:
    outer = max(math.hypot(*v) + piece.radius for piece in pieces for v in piece.vertices)
    return Silhouette(pieces, tuple(map(_circle, pieces)), inner, outer)


def _circle(piece: g.Piece) -> tuple[g.Point, float]:
    xs, ys = zip(*piece.vertices, strict=True)
    centre = (min(xs) + max(xs)) / 2, (min(ys) + max(ys)) / 2
    return centre, max(math.dist(centre, v) for v in piece.vertices) + piece.radius


def _inradius(outline: g.Polygon) -> float:
    edges = zip(outline, outline[1:] + outline[:1], strict=True)
    return min(
        abs(x0 * y1 - x1 * y0) / math.dist((x0, y0), (x1, y1)) for (x0, y0), (x1, y1) in edges
    )


@cache
def block_silhouette(shape: Shape) -> Silhouette:
    """A block's outline for collisions."""
    round_block = shape == Shape.CIRCLE
    inner = c.BLOCK_SIZE if round_block else _inradius(g.block_outline(shape))
    return _silhouette(g.block_pieces(shape), inner)


@cache
def robot_silhouette() -> Silhouette:
    """The robot's outline with open fingers."""
    return _silhouette(g.robot_pieces(), c.ROBOT_RADIUS)


@dataclass(eq=False)
class Solid:
    """A silhouette at a pose."""

    silhouette: Silhouette
    pose: Pose

    @staticmethod
    def of_block(block: Block) -> "Solid":
        """The solid of a scene's block."""
        return Solid(block_silhouette(block.shape), block.pose)

    @staticmethod
    def of_robot(pose: Pose) -> "Solid":
        """The solid of a scene's robot."""
        return Solid(robot_silhouette(), pose)

    @staticmethod
    def of_region(region: Region) -> "Solid":
        """The solid of a scene's goal region."""
        height, width = region.height, region.width
        rectangle = (g.Piece(g.rectangle(width, height)),)
        return Solid(_silhouette(rectangle, min(height, width) / 2), Pose(*region.centre, 0.0))

    @cached_property
    def parts(self) -> list[tuple[g.Piece, g.Point, float]]:
        """Each piece in workspace coordinates, with the centre and radius of a circle around it."""
        pieces, circles, _, _ = self.silhouette
        centres = [g.to_workspace(centre, self.pose) for centre, _ in circles]
        radii = [radius for _, radius in circles]
        return list(zip(g.place(pieces, self.pose), centres, radii, strict=True))

    def overlaps(self, other: "Solid") -> bool:
        """Whether the two overlap."""
        mine, theirs = self.silhouette, other.silhouette
        distance = math.dist(self.pose[:2], other.pose[:2])
        if distance >= mine.outer + theirs.outer:
            return False
        if distance < mine.inner + theirs.inner:
            return True
        return any(g.penetrates(a, b) for a, b in self._near_pairs(other))

    def depth(self, other: "Solid") -> float:
        """How far the two overlap, in units; 0 when apart."""
        depths = (g.depth(a, b) for a, b in self._near_pairs(other))
        return max(0.0, max(depths, default=0.0))

    def _near_pairs(self, other: "Solid") -> Iterable[tuple[g.Piece, g.Piece]]:
        for piece, centre, radius in self.parts:
            for other_piece, other_centre, other_radius in other.parts:
                if math.dist(centre, other_centre) < radius + other_radius:
                    yield piece, other_piece

    def beyond_wall(self) -> float:
        """How far the body reaches beyond the workspace's edge, in units; negative inside."""
        reach = (abs(v) + p.radius for p, _, _ in self.parts for xy in p.vertices for v in xy)
        return max(reach) - c.WORKSPACE_HALF

    def is_inside(self) -> bool:
        """Whether the body lies within the walls."""
        furthest = max(abs(self.pose.x), abs(self.pose.y))
        if furthest + self.silhouette.outer <= c.WORKSPACE_HALF:
            return True
        return furthest + self.silhouette.inner <= c.WORKSPACE_HALF and self.beyond_wall() <= 0.0
