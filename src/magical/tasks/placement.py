"""Placement of regions, robot and blocks by bounded rejection sampling, and checks of overlaps.

Source: docs/specification.md, section 8.

Poses are proposed uniformly for one body at a time, in the order regions, robot, blocks; proposals
that overlap a body, region or wall already placed are rejected. If all proposals for a body are
rejected, placement starts again, a bounded number of times. Scenes are plain data: a failed attempt
changes nothing.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from magical.errors import InvalidSceneError, PlacementError
from magical.scene import Pose, Region, Scene
from magical.scene.constants import COLLISION_SLOP, WORKSPACE_HALF
from magical.tasks.axes import Axis

if TYPE_CHECKING:
    from magical.physics.overlap import Kind

POSITION_JITTER = 0.025  # units, each coordinate
ANGLE_JITTER = 0.05 * math.pi  # rad
SIZE_JITTER = 0.0075  # units, a region's height and width
MAX_PROPOSALS = 1000  # for one body
MAX_RESTARTS = 20  # attempts at one scene, including the first

# Units by which bodies may overlap: the solver itself lets bodies in contact overlap by this much,
# and the published Demo scene of ClusterColour has two blocks that overlap by 0.0095.
OVERLAP_SLACK = COLLISION_SLOP
# Units by which bodies may reach into a wall: ClusterShape's TestShape keeps the Demo poses, where
# a square as the fifth block reaches 0.018 into the right wall. The simulation pushes it out.
WALL_SLACK = 2 * COLLISION_SLOP
ROUNDING = 1e-9  # units


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

    def problem(self, scene: Scene) -> str:
        """Why enclosed blocks are not alone inside their regions, or an empty string."""
        outside = len(scene.blocks) - len(scene.regions)
        for i, region in enumerate(scene.regions if self.encloses else (), start=outside):
            inside = [k for k, block in enumerate(scene.blocks) if region.contains(*block.pose[:2])]
            if inside != [i]:
                return f"expected block {i} alone inside its region, found blocks {inside}"
        return ""


def sample_placement(
    scene: Scene, axes: Axis, rng: np.random.Generator, placement: Placement
) -> Scene:
    """Sample poses and region sizes from a scene with those of Demo.

    With LAYOUT, poses are anywhere; with JITTER, near those of `scene`; with neither, the scene is
    returned unchanged, and nothing is sampled. Raises `PlacementError` if none of `MAX_RESTARTS`
    attempts finds room for all bodies.
    """
    if not axes & (Axis.JITTER | Axis.LAYOUT):
        return scene

    def sample_size(size: float) -> float:
        low, high = placement.region_size
        if Axis.LAYOUT not in axes:
            low, high = max(low, size - SIZE_JITTER), min(high, size + SIZE_JITTER)
        return float(rng.uniform(low, high))

    sized = [
        replace(region, height=sample_size(region.height), width=sample_size(region.width))
        for region in scene.regions
    ]
    scene = replace(scene, regions=tuple(sized))
    for _ in range(MAX_RESTARTS):
        try:
            return _attempt(scene, axes, rng, placement)
        except PlacementError as error:
            failure = error
    raise PlacementError(
        f"{failure}, in the last of {MAX_RESTARTS} attempts; use fewer blocks or smaller regions"
    )


def _attempt(scene: Scene, axes: Axis, rng: np.random.Generator, placement: Placement) -> Scene:
    from magical.physics.overlap import Solid, Solids  # imports pymunk: only when one is placed

    solids, placed, first = Solids.cleared(), list[Solid](), len(scene.regions)
    anywhere = Axis.LAYOUT in axes
    for i, (what, kind, pose) in enumerate(_bodies(scene)):
        centre = Pose(0.0, 0.0, 0.0) if anywhere else pose
        reach, turn = (WORKSPACE_HALF, math.pi) if anywhere else (POSITION_JITTER, ANGLE_JITTER)
        own, enclosed = None, i - len(scene.blocks) - 1  # the region that a block is enclosed in
        if isinstance(kind, Region):
            turn = 0.0
        elif placement.encloses and enclosed >= 0:
            own = placed[enclosed]
            centre = Pose(own.pose.x, own.pose.y, centre.angle)
            reach = min(reach, placement.limit(scene.regions[enclosed]))
        solid = solids.take(kind)
        for _ in range(MAX_PROPOSALS):
            x, y, angle = (2.0 * rng.random(3) - 1.0).tolist()
            x, y = centre.x + reach * x, centre.y + reach * y
            solid.move(Pose(x, y, centre.angle + turn * angle))
            touched = (other for other, _ in solids.overlaps(solid))
            if solid.beyond_wall <= 0.0 and all(other is own for other in touched):
                break
        else:
            raise PlacementError(f"found no room for {what} in {MAX_PROPOSALS} proposals")
        solids.place(solid)
        placed.append(solid)
    poses = [solid.pose for solid in placed]
    regions = [
        Region.from_centre(region.colour, pose.x, pose.y, region.height, region.width)
        for region, pose in zip(scene.regions, poses[:first], strict=True)
    ]
    blocks = [
        replace(block, pose=pose)
        for block, pose in zip(scene.blocks, poses[first + 1 :], strict=True)
    ]
    return replace(scene, robot=poses[first], blocks=tuple(blocks), regions=tuple(regions))


def _bodies(scene: Scene) -> Iterator[tuple[str, "Kind", Pose]]:
    """Regions, robot and blocks: each one's name in messages, its kind and its pose."""
    for i, region in enumerate(scene.regions):
        yield f"region {i} ({region.colour})", region, Pose(*region.centre, 0.0)
    yield "the robot", None, scene.robot
    for i, block in enumerate(scene.blocks):
        yield f"block {i} ({block.colour} {block.shape})", block.shape, block.pose


def validate_scene(scene: Scene) -> None:
    """Raise `InvalidSceneError` if bodies overlap or reach out of the workspace.

    Bodies may overlap by `OVERLAP_SLACK` and reach into walls by `WALL_SLACK`. Blocks and robot may
    be in regions, which have no physical effect.
    """
    from magical.physics.overlap import Solid, Solids  # imports pymunk

    solids, names = Solids.cleared(), dict[Solid, str]()
    for name, kind, pose in _bodies(scene):
        solid = solids.take(kind)
        solid.move(pose)
        if solid.beyond_wall > (ROUNDING if isinstance(kind, Region) else WALL_SLACK):
            raise InvalidSceneError(
                f"scene: {name} at ({pose.x:.3g}, {pose.y:.3g}) reaches {solid.beyond_wall:.3g} "
                "units outside the workspace [-1, 1] x [-1, 1]; move it inside"
            )
        if isinstance(kind, Region):
            continue
        for other, depth in solids.overlaps(solid):
            if depth > OVERLAP_SLACK:
                raise InvalidSceneError(
                    f"scene: {names[other]} and {name} overlap by {depth:.3f} units, expected at "
                    f"most {OVERLAP_SLACK:g}; move them apart"
                )
        solids.place(solid)
        names[solid] = name
