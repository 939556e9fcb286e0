"""Places: where blocks are to be at the end of an episode."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from magical.scene import Region, Scene
from magical.scene.constants import WORKSPACE_HALF
from magical.scene.geometry import Point
from magical.scene.vocabulary import Corner, Wall
from magical.tasks.programs.expressions import Expression
from magical.tasks.programs.selections import Selection
from magical.tasks.programs.wording import Style, describe, name_regions
from magical.tasks.scoring import NEIGHBOUR_DISTANCE

CORNER_NO_SCORE = math.sqrt(2.0)  # units from a corner: no score from here on (appendix A.2.1)
CORNER_FULL_SCORE = CORNER_NO_SCORE / 2  # units: full score within
WALL_ZONE = 0.3  # units from a wall to a block's centre that count as "at" it

CORNERS = {
    corner: ((1 if "right" in corner else -1), (1 if "top" in corner else -1)) for corner in Corner
}  # signs of x and y


@dataclass(frozen=True, repr=False)
class Place(Expression):
    """Where a block may be. `points` are all blocks' centres in units, by index."""

    def degree(self, scene: Scene, block: int, points: Sequence[Point]) -> float:
        """How well a block is placed, from 0 to 1 (there)."""
        return float(self.remaining(scene, block, points) <= 0.0)

    def remaining(self, scene: Scene, block: int, points: Sequence[Point]) -> float:
        """Units that a block has still to go, 0.0 once it is there."""
        raise NotImplementedError

    def phrase(self, scene: Scene, style: Style) -> str:
        """The place in English after a verb of motion."""
        raise NotImplementedError


class InRegion(Place):
    """Inside any region."""

    def degree(self, scene: Scene, block: int, points: Sequence[Point]) -> float:
        return float(any(region.contains(*points[block]) for region in scene.regions))

    def remaining(self, scene: Scene, block: int, points: Sequence[Point]) -> float:
        return min((_distance_to(r, points[block]) for r in scene.regions), default=math.inf)

    def phrase(self, scene: Scene, style: Style) -> str:
        return f"into {name_regions(scene, style)}"


class InOwnColour(Place):
    """Inside a region of the block's own colour."""

    def remaining(self, scene: Scene, block: int, points: Sequence[Point]) -> float:
        colour = scene.blocks[block].colour
        own = (_distance_to(r, points[block]) for r in scene.regions if r.colour == colour)
        return min(own, default=math.inf)

    def phrase(self, scene: Scene, style: Style) -> str:
        return "into the region of its colour"


class OutOfRegions(Place):
    """Outside all regions."""

    def degree(self, scene: Scene, block: int, points: Sequence[Point]) -> float:
        return float(not any(region.contains(*points[block]) for region in scene.regions))

    def remaining(self, scene: Scene, block: int, points: Sequence[Point]) -> float:
        return depth_inside(scene, points[block])

    def phrase(self, scene: Scene, style: Style) -> str:
        return f"out of {name_regions(scene, style, 'any')}"


@dataclass(frozen=True, repr=False)
class InCorner(Place):
    """In a corner of the workspace, by degrees (appendix A.2.1)."""

    corner: Corner

    def degree(self, scene: Scene, block: int, points: Sequence[Point]) -> float:
        beyond = self.remaining(scene, block, points)
        return max(0.0, 1.0 - beyond / (CORNER_NO_SCORE - CORNER_FULL_SCORE))

    def remaining(self, scene: Scene, block: int, points: Sequence[Point]) -> float:
        x, y = CORNERS[self.corner]
        corner = x * WORKSPACE_HALF, y * WORKSPACE_HALF
        return max(0.0, math.dist(points[block], corner) - CORNER_FULL_SCORE)

    def phrase(self, scene: Scene, style: Style) -> str:
        return f"to the {self.corner} corner"


@dataclass(frozen=True, repr=False)
class AtWall(Place):
    """At a wall of the workspace."""

    wall: Wall

    def remaining(self, scene: Scene, block: int, points: Sequence[Point]) -> float:
        x, y = points[block]
        along = {Wall.LEFT: -x, Wall.RIGHT: x, Wall.BOTTOM: -y, Wall.TOP: y}[self.wall]
        return max(0.0, WORKSPACE_HALF - WALL_ZONE - along)

    def phrase(self, scene: Scene, style: Style) -> str:
        return f"to the {self.wall} wall"


@dataclass(frozen=True, repr=False)
class Beside(Place):
    """At most `NEIGHBOUR_DISTANCE` from another block of a selection."""

    selection: Selection

    def remaining(self, scene: Scene, block: int, points: Sequence[Point]) -> float:
        others = self.selection.blocks(scene) - {block}
        nearest = min((math.dist(points[block], points[i]) for i in others), default=math.inf)
        return max(0.0, nearest - NEIGHBOUR_DISTANCE)

    def phrase(self, scene: Scene, style: Style) -> str:
        return f"next to {describe(self.selection, scene, style)}"


def depth_inside(scene: Scene, point: Point) -> float:
    """Units from a point to the nearest edge of a region that it is inside, 0.0 outside all."""
    x, y = point
    depths = (
        min(x - r.x, r.x + r.width - x, r.y - y, y - r.y + r.height)
        for r in scene.regions
        if r.contains(x, y)
    )
    return max(depths, default=0.0)


def _distance_to(region: Region, point: Point) -> float:
    """Units from a point to a region, 0.0 inside."""
    x, y = point
    across = max(region.x - x, 0.0, x - region.x - region.width)
    down = max(region.y - region.height - y, 0.0, y - region.y)
    return math.hypot(across, down)
