"""What the scoring rules share: where blocks are, and which are inside a goal region."""

from magical.errors import InvalidSceneError
from magical.scene import Poses, Region, Scene

Point = tuple[float, float]


def positions(scene: Scene, poses: Poses) -> list[Point]:
    """The blocks' centres in the scene's order; raises `InvalidSceneError` if counts differ."""
    if len(poses.blocks) != len(scene.blocks):
        raise InvalidSceneError(
            f"score: expected poses of the scene's {len(scene.blocks)} blocks, "
            f"found {len(poses.blocks)}"
        )
    return [(x, y) for x, y, _ in poses.blocks.tolist()]


def blocks_inside(region: Region, scene: Scene, poses: Poses) -> set[int]:
    """Numbers of the blocks whose centres lie in the region."""
    return {i for i, xy in enumerate(positions(scene, poses)) if region.contains(*xy)}
