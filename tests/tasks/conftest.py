"""Final states for the scoring rules."""

from collections.abc import Callable, Mapping
from dataclasses import replace

import pytest

from magical.scene import Pose, Poses, Scene

Point = tuple[float, float]
Move = Callable[..., Poses]


def move(
    scene: Scene, blocks: Mapping[int, Point] | None = None, robot: Point | None = None
) -> Poses:
    """The scene's poses, with some blocks, or the robot, at other positions."""
    positions = blocks or {}
    return Poses.at_rest(
        replace(
            scene,
            robot=Pose(*(robot or scene.robot[:2]), scene.robot.angle),
            blocks=tuple(
                replace(block, pose=Pose(*positions.get(i, block.pose[:2]), block.pose.angle))
                for i, block in enumerate(scene.blocks)
            ),
        )
    )


@pytest.fixture(scope="session")
def moved() -> Move:
    """`move`."""
    return move
