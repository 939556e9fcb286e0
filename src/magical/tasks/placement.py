"""Placing regions, robot and blocks by bounded rejection (docs/specification.md, section 8).

One body at a time, uniform proposals, in the order regions, robot, blocks; what would overlap a
body, region or wall already placed is proposed again. A body that finds no room starts the whole
scene anew, a bounded number of times. Scenes are plain data, so giving up leaves nothing behind.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from magical.errors import PlacementError
from magical.scene import Pose, Region, Scene
from magical.scene.constants import WORKSPACE_HALF
from magical.scene.solids import Silhouette, Solid, block_silhouette, robot_silhouette
from magical.tasks.axes import Axis

POSITION_JITTER = 0.025  # units, each coordinate
ANGLE_JITTER = 0.05 * math.pi  # rad
SIZE_JITTER = 0.0075  # units, a region's height and width
MAX_PROPOSALS = 1000  # for one body
MAX_RESTARTS = 20  # of one scene


def _nowhere(count: int) -> Mapping[int, int]:
    return {}


@dataclass(frozen=True)
class Placing:
    """How a task's regions and blocks are placed where the common rules leave a choice."""

    region_size: tuple[float, float] = (0.5, 0.8)  # units: range of height and width
    enclosed: Callable[[int], Mapping[int, int]] = _nowhere  # number of blocks -> block: its region
    margin: float = 0.0  # units from an enclosed block's centre to its region's nearest edge

    def limit(self, region: Region) -> float:
        """How far an enclosed block's centre may be from its region's, in each coordinate."""
        return min(region.height, region.width) / 2 - self.margin


class _Box(NamedTuple):
    """Uniform proposals of poses: a centre, and half the range of each coordinate."""

    centre: Pose
    position: float
    angle: float

    def draw(self, rng: np.random.Generator) -> Pose:
        x, y, angle = (2.0 * rng.random(3) - 1.0).tolist()
        return Pose(
            self.centre.x + self.position * x,
            self.centre.y + self.position * y,
            self.centre.angle + self.angle * angle,
        )

    def around(self, pose: Pose, limit: float) -> "_Box":
        """Positions about another pose, at most `limit` away in each coordinate; angles as here."""
        centre = Pose(pose.x, pose.y, self.centre.angle)
        return _Box(centre, min(limit, self.position), self.angle)


def _box(pose: Pose, axes: Axis) -> _Box:
    if Axis.LAYOUT in axes:
        return _Box(Pose(0.0, 0.0, 0.0), WORKSPACE_HALF, math.pi)
    return _Box(pose, POSITION_JITTER, ANGLE_JITTER)


def scatter(scene: Scene, axes: Axis, rng: np.random.Generator, placing: Placing) -> Scene:
    """The scene with poses and region sizes drawn anew along JITTER or LAYOUT, or unchanged.

    Raises `PlacementError` after `MAX_RESTARTS` scenes in which a body found no room.
    """
    if not axes & (Axis.JITTER | Axis.LAYOUT):
        return scene
    sizes = [_resized(region, axes, rng, placing.region_size) for region in scene.regions]
    scene = replace(scene, regions=tuple(sizes))
    stuck = ""
    for _ in range(MAX_RESTARTS):
        try:
            return _attempt(scene, axes, rng, placing)
        except PlacementError as error:
            stuck = str(error)
    raise PlacementError(
        f"{stuck}, in the last of {MAX_RESTARTS} scenes tried; use fewer blocks or smaller regions"
    )


def _resized(
    region: Region, axes: Axis, rng: np.random.Generator, limits: tuple[float, float]
) -> Region:
    def draw(size: float) -> float:
        low, high = limits
        if Axis.LAYOUT not in axes:
            low, high = max(low, size - SIZE_JITTER), min(high, size + SIZE_JITTER)
        return float(rng.uniform(low, high))

    return replace(region, height=draw(region.height), width=draw(region.width))


def _attempt(scene: Scene, axes: Axis, rng: np.random.Generator, placing: Placing) -> Scene:
    regions = _place_regions(scene, axes, rng)
    robot = _fit("the robot", robot_silhouette(), _box(scene.robot, axes), regions, rng)
    solids, blocks = [*regions, robot], list(scene.blocks)
    enclosed = placing.enclosed(len(blocks))
    for i in sorted(range(len(blocks)), key=lambda i: i in enclosed):
        block, box, obstacles = blocks[i], _box(blocks[i].pose, axes), solids
        if i in enclosed:
            own = regions[enclosed[i]]
            box = box.around(own.pose, placing.limit(scene.regions[enclosed[i]]))
            obstacles = [solid for solid in solids if solid is not own]
        what = f"block {i} ({block.colour} {block.shape})"
        solid = _fit(what, block_silhouette(block.shape), box, obstacles, rng)
        blocks[i] = replace(block, pose=solid.pose)
        solids.append(solid)
    moved = map(_moved, scene.regions, regions)
    return replace(scene, robot=robot.pose, blocks=tuple(blocks), regions=tuple(moved))


def _place_regions(scene: Scene, axes: Axis, rng: np.random.Generator) -> list[Solid]:
    placed: list[Solid] = []
    for i, region in enumerate(scene.regions):
        solid = Solid.of_region(region)
        box = _box(solid.pose, axes)._replace(angle=0.0)
        placed.append(_fit(f"region {i}", solid.silhouette, box, placed, rng))
    return placed


def _moved(region: Region, solid: Solid) -> Region:
    x, y, _ = solid.pose
    return Region.from_centre(region.colour, x, y, region.height, region.width)


def _fit(
    what: str, silhouette: Silhouette, box: _Box, others: list[Solid], rng: np.random.Generator
) -> Solid:
    for _ in range(MAX_PROPOSALS):
        solid = Solid(silhouette, box.draw(rng))
        if solid.is_inside() and not any(map(solid.overlaps, others)):
            return solid
    raise PlacementError(f"found no room for {what} in {MAX_PROPOSALS} proposals")
