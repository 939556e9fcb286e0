"""Positions of blocks, and blocks inside a goal region, for the scoring rules."""

from magical.errors import InvalidSceneError
from magical.scene import Poses, Region, Scene

Point = tuple[float, float]


def positions(scene: Scene, poses: Poses) -> list[Point]:
    """The blocks' centres in the scene's order, in units.

    Raises:
        InvalidSceneError: the poses are those of another number of blocks.
    """
    if len(poses.blocks) != len(scene.blocks):
        raise InvalidSceneError(
            f"score: expected poses of the scene's {len(scene.blocks)} blocks, "
            f"found {len(poses.blocks)}"
        )
    return [(x, y) for x, y, _ in poses.blocks.tolist()]


def blocks_inside(region: Region, scene: Scene, poses: Poses) -> set[int]:
    """Indices of the blocks whose centres lie in the region."""
    return {i for i, xy in enumerate(positions(scene, poses)) if region.contains(*xy)}
