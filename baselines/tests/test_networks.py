"""Architectures (layer sizes of Fig. 11, batch norm), trunks and task-specific last layers."""

from types import SimpleNamespace

import pytest
import torch
from torch import nn

from magical.errors import PluginError, UnknownNameError
from magical_baselines.models import (
    ActorCritic,
    Discriminator,
    PolicyNetwork,
    TaskLinear,
    Trunk,
    centre,
)
from magical_baselines.networks import find_network, network_names

IMAGE = (12, 96, 96)


def images(batch: int = 3) -> torch.Tensor:
    return torch.rand(batch, *IMAGE, generator=torch.Generator().manual_seed(0))


def _convolutions(trunk: Trunk) -> list[nn.Module]:
    assert trunk.convolutions is not None
    return list(trunk.convolutions.children())


WITHOUT_BIAS = SimpleNamespace(
    HIDDEN=(8,),
    make_convolutions=lambda channels, batch_norm: nn.Conv2d(channels, 2, 8, 8, bias=False),
)
WITHOUT_LAYERS = SimpleNamespace(HIDDEN=(), make_convolutions=WITHOUT_BIAS.make_convolutions)


def test_centring_takes_a_first_convolution_without_bias() -> None:
    network = PolicyNetwork(Trunk(f"{__name__}:WITHOUT_BIAS", IMAGE), 1)
    (convolution,) = (m for m in network.modules() if isinstance(m, nn.Conv2d))
    (linear,) = (m for m in network.trunk.linear if isinstance(m, nn.Linear))
    before = convolution.weight.clone(), linear.weight.clone()
    centre(network)
    assert not torch.equal(convolution.weight, before[0])
    assert not torch.equal(linear.weight, before[1])


def test_architectures_need_a_linear_layer() -> None:
    with pytest.raises(PluginError, match="expected one or more sizes in HIDDEN"):
        Trunk(f"{__name__}:WITHOUT_LAYERS", IMAGE)


@pytest.mark.parametrize("batch_norm", [False, True])
@pytest.mark.parametrize("network", network_names())
def test_every_architecture_makes_trunks_of_images_and_of_vectors(
    network: str, batch_norm: bool
) -> None:
    hidden = find_network(network).HIDDEN
    actions = torch.tensor([0, 1, 2])
    for shape in (IMAGE, (27,)):
        trunk = Trunk(network, shape, batch_norm=batch_norm, action_input="one-hot", num_features=7)
        features = trunk(torch.rand(3, *shape), actions)
        assert features.shape == (3, trunk.num_features) == (3, 7)
        assert Trunk(network, shape).num_features == hidden[-1]


@pytest.mark.parametrize("network", network_names())
def test_measuring_the_convolutions_leaves_batch_norm_untouched(network: str) -> None:
    norms = [
        m for m in Trunk(network, IMAGE, batch_norm=True).modules() if isinstance(m, nn.BatchNorm2d)
    ]
    assert norms
    assert all(norm.training and norm.num_batches_tracked == 0 for norm in norms)


def test_paper_trunk_has_the_sizes_of_figure_11() -> None:
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


@pytest.mark.parametrize("network", ["light", "narrow", "paper"])
def test_batch_norm_follows_relu_and_replaces_the_bias(network: str) -> None:
    layers = list(find_network(network).make_convolutions(12, batch_norm=True).children())
    kinds = [type(layer) for layer in layers]
    assert kinds == [nn.Conv2d, nn.ReLU, nn.BatchNorm2d] * (len(kinds) // 3)
    assert all(m.bias is None for m in layers if isinstance(m, nn.Conv2d))
    plain = list(find_network(network).make_convolutions(12, batch_norm=False).children())
    assert all(m.bias is not None for m in plain if isinstance(m, nn.Conv2d))
    assert not any(isinstance(m, nn.BatchNorm2d) for m in plain)


def test_convolutions_are_kept_channels_last() -> None:
    first = next(m for m in Trunk("light", IMAGE).modules() if isinstance(m, nn.Conv2d))
    assert first.weight.is_contiguous(memory_format=torch.channels_last)


def test_each_task_has_a_last_layer_of_its_own() -> None:
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


def test_policies_values_and_discriminators() -> None:
    trunk = Trunk("light", IMAGE)
    tasks = torch.tensor([0, 1, 0])
    assert PolicyNetwork(trunk, 2)(images(), tasks).shape == (3, 18)
    critic = ActorCritic(trunk, 2)
    logits, values = critic.logits_and_values(images(), tasks)
    assert (logits.shape, values.shape) == ((3, 18), (3,))
    assert torch.equal(critic(images(), tasks), logits)
    vectors = ActorCritic(Trunk("paper", (27,)), 1)
    assert vectors.logits_and_values(torch.rand(3, 27), tasks)[1].shape == (3,)


def test_discriminator_sees_the_action_after_the_convolutions() -> None:
    trunk = Trunk("paper", IMAGE, batch_norm=True, action_input="one-hot")
    discriminator = Discriminator(trunk, num_tasks=1).eval()
    assert trunk.linear[0].in_features == 4608 + 18
    none = torch.zeros(3, dtype=torch.int64)
    a = discriminator(images(), torch.tensor([0, 1, 2]), none)
    b = discriminator(images(), torch.tensor([0, 1, 3]), none)
    assert a.shape == (3,)
    assert torch.equal(a[:2], b[:2])
    assert a[2] != b[2]


def test_unknown_network() -> None:
    with pytest.raises(UnknownNameError, match=r"'huge'.*narrow, paper"):
        find_network("huge")
