"""One of everything to render."""

import pytest

from magical.scene import COLOURS, SHAPES, Block, Pose, Poses, Region, Scene
from tests.render.cases import Case


@pytest.fixture(scope="session")
def case() -> Case:
    blocks = tuple(
        Block(shape, colour, Pose(0.5 * i - 0.7, 0.3 * i - 0.6, 0.4 * i))
        for i, (shape, colour) in enumerate(zip(SHAPES, COLOURS, strict=True))
    )
    regions = (Region(COLOURS[0], -0.8, 0.9, 0.5, 0.6), Region(COLOURS[2], 0.2, -0.1, 0.7, 0.6))
    scene = Scene(Pose(0.1, 0.2, 0.7), blocks, regions)
    return scene, Poses.at_rest(scene)
