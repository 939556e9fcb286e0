"""Architectures (layer sizes of Fig. 11, batch norm), trunks and task-specific last layers."""

import math
from types import SimpleNamespace

import pytest
import torch
from torch import Tensor, nn

from baselines.tests.conftest import TASKS
from baselines.tests.tiny_runs import tiny
from magical_baselines.algorithms.gail import GAILConfig, make_discriminator
from magical_baselines.models import PolicyNetwork, TaskLinear, Trunk, centre
from magical_baselines.networks import find_network

IMAGE = (12, 96, 96)


def images(batch=3):
    return torch.rand(batch, *IMAGE, generator=torch.Generator().manual_seed(0))


def _convolutions(trunk):
    assert trunk.convolutions is not None
    return list(trunk.convolutions.children())


WITHOUT_BIAS = SimpleNamespace(
    HIDDEN=(8,),
    make_convolutions=lambda channels, batch_norm: nn.Conv2d(channels, 2, 8, 8, bias=False),
)


def test_centring_takes_a_first_convolution_without_bias():
    network = PolicyNetwork(Trunk(f"{__name__}:WITHOUT_BIAS", IMAGE), 1)
    (convolution,) = (m for m in network.modules() if isinstance(m, nn.Conv2d))
    (linear,) = (m for m in network.trunk.linear if isinstance(m, nn.Linear))
    before = convolution.weight.clone(), linear.weight.clone()
    centre(network)
    assert not torch.equal(convolution.weight, before[0])
    assert not torch.equal(linear.weight, before[1])


@pytest.mark.parametrize("batch_norm", [False, True])
@pytest.mark.parametrize("network", ["light", "narrow", "paper"])
def test_every_architecture_makes_trunks_of_images_and_of_vectors(network, batch_norm):
    hidden = find_network(network).HIDDEN
    actions = torch.tensor([0, 1, 2])
    for shape in (IMAGE, (27,)):
        trunk = Trunk(network, shape, batch_norm=batch_norm, action_input="one-hot", num_features=7)
        features = trunk(torch.rand(3, *shape), actions)
        assert features.shape == (3, trunk.num_features) == (3, 7)
        assert Trunk(network, shape).num_features == hidden[-1]


def test_paper_trunk_has_the_sizes_of_figure_11():
    trunk = Trunk("paper", IMAGE)
    shapes = []
    x = images(1)
    for layer in _convolutions(trunk):
        x = layer(x)
        if isinstance(layer, nn.Conv2d):
            shapes.append(tuple(x.shape[1:]))
    assert shapes == [(64, 96, 96), (128, 48, 48), (128, 24, 24), (128, 12, 12), (128, 6, 6)]
    assert x.flatten(1).shape == (1, 4608)
    sizes = [(m.in_features, m.out_features) for m in trunk.linear if isinstance(m, nn.Linear)]
    assert sizes == [(4608, 256), (256, 256)]
    kernels = [m.kernel_size for m in _convolutions(trunk) if isinstance(m, nn.Conv2d)]
    assert kernels == [(5, 5), *[(3, 3)] * 4]


def test_each_task_has_a_last_layer_of_its_own():
    head = TaskLinear(5, 4, num_tasks=3)
    features = torch.rand(6, 5)
    tasks = torch.tensor([0, 1, 2, 2, 1, 0])
    got = head(features, tasks)
    weight, bias = head.linear.weight.view(3, 4, 5), head.linear.bias.view(3, 4)
    for row, task in enumerate(tasks.tolist()):
        assert torch.allclose(got[row], weight[task] @ features[row] + bias[task], atol=1e-6)
    got[1].sum().backward()
    assert head.linear.weight.grad is not None
    moved = head.linear.weight.grad.view(3, 4, 5).abs().sum(dim=(1, 2)) > 0
    assert moved.tolist() == [False, True, False]


ONE = TASKS[:1]
IMAGE = (12, 96, 96)


def first_input(trunk, images, *actions):
    """What the first convolution of a trunk gets."""
    seen: list[Tensor] = []
    assert isinstance(trunk.convolutions, nn.Sequential)
    trunk.convolutions[0].register_forward_hook(lambda _, inputs, __: seen.append(inputs[0]))
    trunk(images, *actions)
    return seen[0]


def test_pixels_are_mapped_to_the_configured_range():
    images = torch.rand(2, *IMAGE, generator=torch.Generator().manual_seed(0))
    assert torch.equal(first_input(Trunk("light", IMAGE), images), images)
    symmetric = Trunk("light", IMAGE, pixel_range=(-1.0, 1.0))
    assert torch.allclose(first_input(symmetric, images), 2.0 * images - 1.0)
    once = symmetric.to_range(images)
    assert torch.equal(symmetric(once, in_range=True), symmetric(images))
    vectors = torch.rand(2, 27)
    networks = [Trunk("light", (27,), pixel_range=pixels) for pixels in ((0.0, 1.0), (-1.0, 1.0))]
    networks[1].load_state_dict(networks[0].state_dict())
    assert torch.equal(networks[0](vectors), networks[1](vectors))
    assert networks[1].to_range(vectors) is vectors


def test_a_discriminator_s_last_layer_is_normal_in_multi_task_runs_alone():
    spreads = []
    for tasks in (ONE, TASKS):
        config = tiny(GAILConfig, "published-code", tasks=tasks, demos="")
        last = make_discriminator(config).last.linear
        spreads.append(torch.cat([last.weight.flatten(), last.bias]).std().item())
    plain = 1.0 / math.sqrt(3.0 * 256)  # of PyTorch's default, uniform within 256 ** -0.5
    assert spreads == pytest.approx([plain, 1.0], rel=0.15)
