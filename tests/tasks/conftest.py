"""Final states for the scoring rules."""

from collections.abc import Callable, Mapping
from dataclasses import replace

import pytest

from magical.scene import Pose, Poses, Scene

Point = tuple[float, float]
Move = Callable[..., Poses]


@pytest.fixture(scope="session")
def moved() -> Move:
    """`moved(scene, {index: (x, y)}, robot=(x, y))`: the scene's poses, some at other positions."""

    def move(
        scene: Scene, blocks: Mapping[int, Point] | None = None, robot: Point | None = None
    ) -> Poses:
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

    return move
