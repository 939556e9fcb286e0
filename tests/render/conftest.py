"""Scenes to render, and the slow reference renderer."""

import importlib.util
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from magical.scene import COLOURS, SHAPES, Block, Pose, Poses, Region, Scene

Case = tuple[Scene, Poses]


@pytest.fixture(scope="session")
def reference_render() -> Callable[..., NDArray[np.uint8]]:
    """`render(scene, poses, view, size, samples)` of the slow reference renderer."""
    path = Path(__file__).with_name("reference_renderer.py")
    spec = importlib.util.spec_from_file_location("reference_renderer", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    render: Callable[..., NDArray[np.uint8]] = module.render
    return render


@pytest.fixture(scope="session")
def random_case() -> Callable[[Any], Case]:
    """A scene and poses sampled from a seed: overlapping, partly outside, any order."""

    def make(seed: int) -> Case:
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

    return make


@pytest.fixture(scope="session")
def case() -> Case:
    """One of everything."""
    blocks = tuple(
        Block(shape, colour, Pose(0.5 * i - 0.7, 0.3 * i - 0.6, 0.4 * i))
        for i, (shape, colour) in enumerate(zip(SHAPES, COLOURS, strict=True))
    )
    regions = (Region(COLOURS[0], -0.8, 0.9, 0.5, 0.6), Region(COLOURS[2], 0.2, -0.1, 0.7, 0.6))
    scene = Scene(Pose(0.1, 0.2, 0.7), blocks, regions)
    return scene, Poses.at_rest(scene)
