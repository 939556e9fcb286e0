"""Final states, and sampled scenes that several tests look at."""

from collections.abc import Mapping
from dataclasses import replace
from functools import cache

import numpy as np

from magical.scene import Dynamics, Pose, Poses, Scene
from magical.tasks import get_task

Point = tuple[float, float]
SCENES = 40  # of each environment


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


@cache
def sampled(task: str, variant: str) -> list[tuple[Scene, Dynamics]]:
    """Scenes and dynamics of an environment, sampled once for all tests."""
    rng = np.random.default_rng(1)
    return [get_task(task).sample(variant, rng) for _ in range(SCENES)]


def scenes_of(task: str, variant: str) -> list[Scene]:
    """The scenes of `sampled`."""
    return [scene for scene, _ in sampled(task, variant)]
