"""Generic networks of parsed objects."""

import gymnasium as gym
import numpy as np
import pytest
import torch
from torch import Tensor, nn

import magical  # noqa: F401 - registers the environments
from studies.intent.object_networks import (
    DEEP_SET,
    FEATURES,
    SET_TRANSFORMER,
    Architecture,
    Objects,
)

PLACES = slice(12, 14)  # of an element's features: x and y


@pytest.fixture(scope="module")
def seen() -> tuple[Tensor, gym.Env]:
    env = gym.make("magical/MatchRegions-TestAll-LoRes4A-v0")
    stacks = [env.reset(seed=seed)[0].transpose(2, 0, 1) for seed in range(3)]
    return torch.from_numpy(np.stack(stacks)) / 255.0, env


def test_every_object_is_an_element(seen: tuple[Tensor, gym.Env]) -> None:
    images, env = seen
    elements, present = Objects()(images)
    assert elements.shape[2] == FEATURES
    state = env.get_wrapper_attr("state")()
    scene, blocks = state.scene, state.poses.blocks[:, :2]
    last, shown = elements[-1], present[-1]
    assert int(shown.sum()) == 1 + len(scene.blocks) + len(scene.regions)
    found = last[shown][1 : 1 + len(blocks), PLACES].numpy()
    order = [int(np.linalg.norm(found - block, axis=1).argmin()) for block in blocks]
    assert sorted(order) == list(range(len(blocks)))
    np.testing.assert_allclose(found[order], blocks, atol=0.03)


class Shuffled(nn.Module):
    """The elements in another order, the robot's last."""

    def __init__(self, objects: nn.Module) -> None:
        super().__init__()
        self.objects = objects

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor]:
        elements, present = self.objects(images)
        return elements.flip(1), present.flip(1)


@pytest.mark.parametrize("architecture", [DEEP_SET, SET_TRANSFORMER])
def test_features_do_not_depend_on_the_order(
    architecture: Architecture, seen: tuple[Tensor, gym.Env]
) -> None:
    images, _ = seen
    network = architecture.make_convolutions(images.shape[1], False)
    with torch.no_grad():
        features = network(images)
        network.register_module("objects", Shuffled(network.get_submodule("objects")))
        torch.testing.assert_close(network(images), features, rtol=1e-4, atol=1e-5)
    assert features.std(dim=0).max() > 0.0
