"""Scenes and poses to render."""

import numpy as np

from magical.scene import COLOURS, SHAPES, Block, Pose, Poses, Region, Scene

Case = tuple[Scene, Poses]


def random_case(seed: int) -> Case:
    """A scene and poses sampled from a seed: overlapping, partly outside, any order."""
    rng = np.random.default_rng(seed)
    blocks = [
        Block(rng.choice(SHAPES), rng.choice(COLOURS), Pose(*rng.uniform(-1.3, 1.3, 3)))
        for _ in range(rng.integers(9))
    ]
    regions = [
        Region.from_centre(rng.choice(COLOURS), *rng.uniform(-1, 1, 2), *rng.uniform(0.3, 1, 2))
        for _ in range(rng.integers(4))
    ]
    robot = Pose(*rng.uniform((-1, -1, -4), (1, 1, 4)))
    scene = Scene(robot, tuple(blocks), tuple(regions), bool(rng.integers(2)))
    poses = Poses.at_rest(scene)
    poses.bodies[1:5, 2] += rng.uniform(-0.5, 0.5, 4)  # fingers and eyes
    poses.bodies[5:] += rng.uniform(-0.2, 0.2, poses.blocks.shape)
    return scene, poses
