"""Placement of regions, robot and blocks by bounded rejection sampling.

Source: docs/specification.md, section 8.

Poses are proposed uniformly for one body at a time, in the order regions, robot, blocks; proposals
that overlap a body, region or wall already placed are rejected. If all proposals for a body are
rejected, placement starts again, a bounded number of times. Scenes are plain data: a failed attempt
changes nothing.
"""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from magical.errors import PlacementError
from magical.scene import Pose, Region, Scene, Shape
from magical.scene.constants import WORKSPACE_HALF
from magical.tasks.axes import Axis

POSITION_JITTER = 0.025  # units, each coordinate
ANGLE_JITTER = 0.05 * math.pi  # rad
SIZE_JITTER = 0.0075  # units, a region's height and width
MAX_PROPOSALS = 1000  # for one body
MAX_RESTARTS = 20  # attempts at one scene, including the first


@dataclass(frozen=True)
class Placement:
    """How a task's regions and blocks are placed where the common rules leave a choice.

    Attributes:
        region_size: range of a region's height and width, in units.
        encloses: whether the last blocks, as many as there are regions, start inside these, one
            each, in order.
        margin: distance of an enclosed block's centre from its region's nearest edge, in units.
    """

    region_size: tuple[float, float] = (0.5, 0.8)
    encloses: bool = False
    margin: float = 0.0

    def limit(self, region: Region) -> float:
        """Largest offset of an enclosed block's centre from its region's, in each coordinate."""
        return min(region.height, region.width) / 2 - self.margin


class _Box(NamedTuple):
    """A box of poses to propose from: its centre, and half its extent in position and angle."""

    centre: Pose
    position: float
    angle: float

    def sample(self, rng: np.random.Generator) -> Pose:
        x, y, angle = (2.0 * rng.random(3) - 1.0).tolist()
        return Pose(
            self.centre.x + self.position * x,
            self.centre.y + self.position * y,
            self.centre.angle + self.angle * angle,
        )

    def around(self, pose: Pose, limit: float) -> "_Box":
        """A box around another position, at most `limit` from it; angles as in this one."""
        centre = Pose(pose.x, pose.y, self.centre.angle)
        return _Box(centre, min(limit, self.position), self.angle)


def _box(pose: Pose, axes: Axis) -> _Box:
    if Axis.LAYOUT in axes:
        return _Box(Pose(0.0, 0.0, 0.0), WORKSPACE_HALF, math.pi)
    return _Box(pose, POSITION_JITTER, ANGLE_JITTER)


def sample_placement(
    scene: Scene, axes: Axis, rng: np.random.Generator, placement: Placement
) -> Scene:
    """Sample poses and region sizes.

    Args:
        scene: the scene with the poses and region sizes of Demo.
        axes: with LAYOUT, poses are anywhere; with JITTER, near those of `scene`; with neither,
            the scene is returned unchanged, and nothing is sampled.
        rng: the random generator.
        placement: the task's own rules.

    Raises:
        PlacementError: each of `MAX_RESTARTS` attempts found no room for some body.
    """
    if not axes & (Axis.JITTER | Axis.LAYOUT):
        return scene
    sizes = [_resized(region, axes, rng, placement.region_size) for region in scene.regions]
    scene = replace(scene, regions=tuple(sizes))
    failure = ""
    for _ in range(MAX_RESTARTS):
        try:
            return _attempt(scene, axes, rng, placement)
        except PlacementError as error:
            failure = str(error)
    raise PlacementError(
        f"{failure}, in the last of {MAX_RESTARTS} attempts; use fewer blocks or smaller regions"
    )


def _resized(
    region: Region, axes: Axis, rng: np.random.Generator, limits: tuple[float, float]
) -> Region:
    def sample_size(size: float) -> float:
        low, high = limits
        if Axis.LAYOUT not in axes:
            low, high = max(low, size - SIZE_JITTER), min(high, size + SIZE_JITTER)
        return float(rng.uniform(low, high))

    return replace(region, height=sample_size(region.height), width=sample_size(region.width))


def _attempt(scene: Scene, axes: Axis, rng: np.random.Generator, placement: Placement) -> Scene:
    from magical.physics.overlap import Solid, Solids  # imports pymunk: only when one is placed

    solids, blocks = Solids.cleared(), list(scene.blocks)

    def fit(what: str, kind: Shape | Region | None, box: _Box, own: Solid | None = None) -> Solid:
        """Place a solid apart from those placed already, except for its own region."""
        solid = solids.take(kind)
        for _ in range(MAX_PROPOSALS):
            solid.move(box.sample(rng))
            if solid.beyond_wall <= 0.0 and all(o is own for o, _ in solids.overlaps(solid)):
                solids.place(solid)
                return solid
        raise PlacementError(f"found no room for {what} in {MAX_PROPOSALS} proposals")

    regions = [
        fit(f"region {i}", region, _box(Pose(*region.centre, 0.0), axes)._replace(angle=0.0))
        for i, region in enumerate(scene.regions)
    ]
    robot = fit("the robot", None, _box(scene.robot, axes)).pose
    outside = len(blocks) - len(regions)
    for i, block in enumerate(scene.blocks):
        box, own = _box(block.pose, axes), None
        if placement.encloses and i >= outside:
            own = regions[i - outside]
            box = box.around(own.pose, placement.limit(scene.regions[i - outside]))
        solid = fit(f"block {i} ({block.colour} {block.shape})", block.shape, box, own)
        blocks[i] = replace(block, pose=solid.pose)
    moved = tuple(
        Region.from_centre(region.colour, *solid.pose[:2], region.height, region.width)
        for region, solid in zip(scene.regions, regions, strict=True)
    )
    return replace(scene, robot=robot, blocks=tuple(blocks), regions=moved)
