"""Places: where blocks should be at the end of an episode."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from magical.scene import Scene
from magical.scene.constants import WORKSPACE_HALF
from magical.scene.geometry import Point, lengths
from magical.scene.vocabulary import Corner, Wall
from magical.tasks.programs.expressions import Expression
from magical.tasks.programs.selections import Selection
from magical.tasks.programs.states import Floats
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
    """Where a block may be. `points` are the centres of all N blocks, in units."""

    def degree(self, scene: Scene, block: int, points: Sequence[Point]) -> float:
        """How well a block is placed, from 0 to 1 (there)."""
        return float(self.remaining(scene, np.array(points))[block] <= 0.0)

    def remaining(self, scene: Scene, points: Floats) -> Floats:
        """Distances (..., N) that blocks at points (..., N, 2) must still move, 0.0 once there."""
        raise NotImplementedError

    def phrase(self, scene: Scene, style: Style) -> str:
        """The place in English after a verb of motion."""
        raise NotImplementedError


class InRegion(Place):
    """Inside any region."""

    def degree(self, scene: Scene, block: int, points: Sequence[Point]) -> float:
        return float(any(region.contains(*points[block]) for region in scene.regions))

    def remaining(self, scene: Scene, points: Floats) -> Floats:
        nearest: Floats = distances_to_regions(scene, points).min(axis=-1, initial=np.inf)
        return nearest

    def phrase(self, scene: Scene, style: Style) -> str:
        return f"into {name_regions(scene, style)}"


class InOwnColour(Place):
    """Inside a region of the block's own colour."""

    def remaining(self, scene: Scene, points: Floats) -> Floats:
        colours = np.array([region.colour for region in scene.regions])
        others = np.array([block.colour for block in scene.blocks])[:, None] != colours  # (N, R)
        distances = np.where(others, np.inf, distances_to_regions(scene, points))
        nearest: Floats = distances.min(axis=-1, initial=np.inf)
        return nearest

    def phrase(self, scene: Scene, style: Style) -> str:
        return "into the region of its colour"


class OutOfRegions(Place):
    """Outside all regions."""

    def degree(self, scene: Scene, block: int, points: Sequence[Point]) -> float:
        return float(not any(region.contains(*points[block]) for region in scene.regions))

    def remaining(self, scene: Scene, points: Floats) -> Floats:
        deepest: Floats = depths_in_regions(scene, points).max(axis=-1, initial=0.0)
        return deepest

    def phrase(self, scene: Scene, style: Style) -> str:
        return f"out of {name_regions(scene, style, 'any')}"


@dataclass(frozen=True, repr=False)
class InCorner(Place):
    """In a corner of the workspace, graded by distance (appendix A.2.1)."""

    corner: Corner

    def degree(self, scene: Scene, block: int, points: Sequence[Point]) -> float:
        left = CORNER_NO_SCORE - math.dist(points[block], self._point)
        return min(max(left / (CORNER_NO_SCORE - CORNER_FULL_SCORE), 0.0), 1.0)

    def remaining(self, scene: Scene, points: Floats) -> Floats:
        return (lengths(points - self._point) - CORNER_FULL_SCORE).clip(min=0.0)

    @property
    def _point(self) -> Point:
        x, y = CORNERS[self.corner]
        return x * WORKSPACE_HALF, y * WORKSPACE_HALF

    def phrase(self, scene: Scene, style: Style) -> str:
        return f"to the {self.corner} corner"


@dataclass(frozen=True, repr=False)
class AtWall(Place):
    """At a wall of the workspace."""

    wall: Wall

    def remaining(self, scene: Scene, points: Floats) -> Floats:
        x, y = points[..., 0], points[..., 1]
        along = {Wall.LEFT: -x, Wall.RIGHT: x, Wall.BOTTOM: -y, Wall.TOP: y}[self.wall]
        left: Floats = (WORKSPACE_HALF - WALL_ZONE - along).clip(min=0.0)
        return left

    def phrase(self, scene: Scene, style: Style) -> str:
        return f"to the {self.wall} wall"


@dataclass(frozen=True, repr=False)
class Beside(Place):
    """At most `NEIGHBOUR_DISTANCE` from another block in a selection."""

    selection: Selection

    def remaining(self, scene: Scene, points: Floats) -> Floats:
        chosen = np.array(sorted(self.selection.blocks(scene)), np.intp)
        away = lengths(points[..., :, None, :] - points[..., None, chosen, :])
        away[..., chosen, np.arange(len(chosen))] = np.inf  # no block is next to itself
        left: Floats = away.min(axis=-1, initial=np.inf) - NEIGHBOUR_DISTANCE
        return left.clip(min=0.0)

    def phrase(self, scene: Scene, style: Style) -> str:
        return f"next to {describe(self.selection, scene, style)}"


def depths_in_regions(scene: Scene, points: Floats) -> Floats:
    """Distances (..., R) of points (..., 2) from each region's nearest edge, negative outside."""
    x, y = points[..., 0, None], points[..., 1, None]
    left, top, width, height = _rectangles(scene)
    across = np.minimum(x - left, left + width - x)
    depths: Floats = np.minimum(across, np.minimum(top - y, y - (top - height)))
    return depths


def distances_to_regions(scene: Scene, points: Floats) -> Floats:
    """Distances (..., R) from points (..., 2) to each region, 0.0 inside."""
    x, y = points[..., 0, None], points[..., 1, None]
    left, top, width, height = _rectangles(scene)
    across = np.maximum(left - x, x - left - width).clip(min=0.0)
    down = np.maximum(top - height - y, y - top).clip(min=0.0)
    distances: Floats = np.hypot(across, down)
    return distances


def _rectangles(scene: Scene) -> Floats:
    """Left and top edges, widths and heights of the regions: (4, R)."""
    return np.array([(r.x, r.y, r.width, r.height) for r in scene.regions]).reshape(-1, 4).T
