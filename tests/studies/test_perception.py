"""Learned perception of random scenes."""

import gymnasium
import numpy as np
import pytest
import torch
from torch.nn import functional

import magical  # noqa: F401 (registers the environments)
from magical.scene import COLOURS, SHAPES
from magical.tasks import get_task
from magical_goals.objects.parser import ABSENT, parse_frames
from studies.intent.perception import (
    CELLS,
    FIND_OBJECTS,
    KINDS,
    Batch,
    Detector,
    Sample,
    decode,
    losses,
    random_sample,
    to_images,
)

CLASSES = [[], [len(COLOURS), len(SHAPES)], [len(COLOURS)]]  # the last values of each kind


@pytest.fixture(scope="module")
def samples() -> list[Sample]:
    rng = np.random.default_rng(0)
    return [random_sample(rng) for _ in range(24)]


def told(batch: Batch) -> torch.Tensor:
    """The channels of a network that says what it should."""
    parts = [torch.zeros(len(batch.frames), size, CELLS, CELLS) for size in KINDS]
    for kind, part in enumerate(parts):
        part[:, 0] = torch.logit(batch.likely[:, kind], 1e-6)
        for (sample, i, j), values in zip(batch.rows[kind], batch.values[kind], strict=True):
            cut = len(values) - len(CLASSES[kind])
            classes = [
                functional.one_hot(torch.tensor(int(value)), size)
                for value, size in zip(values[cut:], CLASSES[kind], strict=True)
            ]
            part[sample, 1:, i, j] = torch.cat([torch.tensor(values[:cut]), *classes])
    return torch.cat(parts, 1)


def test_what_cells_should_say_is_the_scene(samples: list[Sample]) -> None:
    found = decode(told(Batch(samples)))
    for k, (scene, _, fingers) in enumerate(samples):
        np.testing.assert_allclose(found.robot[k], scene.robot, atol=1e-5)
        np.testing.assert_allclose(found.fingers[k], fingers, atol=1e-5)
        assert (found.colours[k] != ABSENT).sum() == len(scene.blocks)
        for block in scene.blocks:
            near = np.hypot(*(found.blocks[k] - block.pose[:2]).T).argmin()
            np.testing.assert_allclose(found.blocks[k, near], block.pose[:2], atol=1e-5)
            assert COLOURS[found.colours[k, near]] == block.colour
            assert SHAPES[found.shapes[k, near]] == block.shape


def test_random_scenes_are_those_that_are_rendered(samples: list[Sample]) -> None:
    parsed = parse_frames(Batch(samples).frames)
    places = np.array([scene.robot for scene, _, _ in samples])
    assert np.abs(parsed.robot[:, :2] - places[:, :2]).mean() < 0.02


def test_a_few_batches_lower_the_losses(samples: list[Sample]) -> None:
    torch.manual_seed(0)
    detector, batch = Detector(), Batch(samples)
    optimizer = torch.optim.Adam(detector.parameters(), 3e-3)
    images, totals = to_images(batch.frames), []
    for _ in range(8):
        total = torch.stack(list(losses(detector(images), batch).values())).sum()
        optimizer.zero_grad()
        torch.autograd.backward(total)
        optimizer.step()
        totals.append(total.item())
    assert totals[-1] < 0.5 * totals[0]


def test_the_trained_network_finds_the_blocks_of_scenes() -> None:
    env = gymnasium.make("magical/ClusterShape-TestAll-LoRes4A-v0")
    rng = np.random.default_rng(0)
    scenes = [get_task("ClusterShape").sample("TestAll", rng) for _ in range(8)]
    frames = [env.reset(options={"scene": scene})[0][..., -3:] for scene, _ in scenes]
    found = FIND_OBJECTS(np.stack(frames))
    for t, (scene, _) in enumerate(scenes):
        (seen,) = np.nonzero(found.colours[t] >= 0)
        assert len(seen) == len(scene.blocks)
        places = np.array([block.pose[:2] for block in scene.blocks])
        distances = np.linalg.norm(places[:, None] - found.blocks[t, seen], axis=-1)
        assert distances.min(axis=1).max() < 0.02
        shapes = [SHAPES[found.shapes[t, k]] for k in seen[distances.argmin(axis=1)]]
        assert shapes == [block.shape for block in scene.blocks]
