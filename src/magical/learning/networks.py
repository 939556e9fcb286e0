"""Networks for policies, value functions and discriminators.

Source: appendix B, Fig. 11; docs/specification.md, section 10.

A trunk turns observations into features; a last layer a task turns features into logits, values or
scores. Images come in as float (B, C, H, W) in [0, 1], `tasks` as int64 (B,): the position of each
row's task in the configuration.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from magical.errors import UnknownNameError
from magical.scene import NUM_ACTIONS

MEAN_BRIGHTNESS = 0.92  # of the tasks' frames, in [0, 1]


@dataclass(frozen=True, slots=True)
class Width:
    """A trunk's layers: (channels, kernel size, stride) a convolution, then linear layers."""

    convolutions: tuple[tuple[int, int, int], ...]
    linear: tuple[int, ...]


WIDTHS = {
    "paper": Width(((64, 5, 1), *[(128, 3, 2)] * 4), (256, 256)),
    "small": Width(((32, 5, 2), *[(64, 3, 2)] * 3), (256,)),
    "light": Width(((32, 5, 4), (64, 3, 2), (64, 3, 2)), (256,)),
}


def get_width(name: str) -> Width:
    """A width by name; raises `UnknownNameError`."""
    if name not in WIDTHS:
        raise UnknownNameError(f"network {name!r} is unknown; expected one of: {', '.join(WIDTHS)}")
    return WIDTHS[name]


class Trunk(nn.Module):
    """Everything but the last layer: convolutions, flatten, linear layers.

    Batch norm, where it is used, follows each convolution's ReLU. With `action_input` the one-hot
    action joins the flattened output of the convolutions.
    """

    def __init__(
        self,
        width: Width,
        image_shape: tuple[int, ...],
        batch_norm: bool = False,
        action_input: bool = False,
    ) -> None:
        super().__init__()
        channels, rows, columns = image_shape
        layers: list[nn.Module] = []
        for out, kernel, stride in width.convolutions:
            layers += [
                nn.Conv2d(channels, out, kernel, stride, kernel // 2, bias=not batch_norm),
                nn.ReLU(),
            ]
            layers += [nn.BatchNorm2d(out)] if batch_norm else []
            channels, rows, columns = out, -(-rows // stride), -(-columns // stride)
        self.convolutions = nn.Sequential(*layers, nn.Flatten())
        self.action_input = action_input
        inputs = channels * rows * columns + NUM_ACTIONS * action_input
        self.linear = _linear_layers(inputs, width.linear)
        self.features = width.linear[-1]
        # Convolutions are fastest with this memory layout.
        self.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def forward(self, images: Tensor, actions: Tensor | None = None) -> Tensor:
        """Features (B, self.features) of images (B, C, H, W), and of actions (B,) if asked for."""
        flat = self.convolutions(images)  # (B, C * H * W)
        if self.action_input:
            assert actions is not None
            one_hot = functional.one_hot(actions, NUM_ACTIONS)  # (B, 18)
            flat = torch.cat([flat, one_hot.to(flat.dtype)], dim=1)
        features: Tensor = self.linear(flat)
        return features


class StateTrunk(nn.Module):
    """A trunk for state vectors (B, size): linear layers alone."""

    def __init__(self, size: int, linear: tuple[int, ...] = (256, 256)) -> None:
        super().__init__()
        self.linear = _linear_layers(size, linear)
        self.features = linear[-1]

    def forward(self, vectors: Tensor) -> Tensor:
        """Features (B, self.features)."""
        features: Tensor = self.linear(vectors)
        return features


def centre(network: "ActorCritic") -> None:
    """First weights from which a network of images without batch norm learns at once.

    PyTorch's own shrink what differs between two frames, which are nearly white, to a thousandth
    in the features. Here He's scale keeps it, the first convolution's biases cancel a plain frame
    of mean brightness, and the policy begins nearly uniform.
    """
    layers = [m for m in network.modules() if isinstance(m, nn.Conv2d | nn.Linear)]
    for layer in layers:
        nn.init.kaiming_normal_(layer.weight, nonlinearity="relu")
        assert layer.bias is not None
        nn.init.zeros_(layer.bias)
    with torch.no_grad():
        first = layers[0]
        assert first.bias is not None
        first.bias.copy_(-MEAN_BRIGHTNESS * first.weight.flatten(1).sum(dim=1))
        network.policy.linear.weight.mul_(0.01)


def _linear_layers(inputs: int, sizes: tuple[int, ...]) -> nn.Sequential:
    layers: list[nn.Module] = []
    for size in sizes:
        layers += [nn.Linear(inputs, size), nn.ReLU()]
        inputs = size
    return nn.Sequential(*layers)


class TaskLinear(nn.Module):
    """The last layer, with weights of its own for each task.

    All tasks' outputs are computed and each row's picked: with a handful of tasks that is cheaper
    than sorting rows, and shapes stay static.
    """

    def __init__(self, inputs: int, outputs: int, num_tasks: int) -> None:
        super().__init__()
        self.num_tasks = num_tasks
        self.linear = nn.Linear(inputs, outputs * num_tasks)

    def forward(self, features: Tensor, tasks: Tensor) -> Tensor:
        """Outputs (B, outputs) of features (B, inputs) for each row's task (B,)."""
        every: Tensor = self.linear(features)
        if self.num_tasks == 1:
            return every
        every = every.view(len(features), self.num_tasks, -1)
        index = tasks.view(-1, 1, 1).expand(-1, 1, every.shape[2])
        return every.gather(1, index).squeeze(1)


class PolicyNetwork(nn.Module):
    """Logits of the 18 actions."""

    def __init__(self, trunk: Trunk | StateTrunk, num_tasks: int) -> None:
        super().__init__()
        self.trunk = trunk
        self.policy = TaskLinear(trunk.features, NUM_ACTIONS, num_tasks)

    def forward(self, observations: Tensor, tasks: Tensor) -> Tensor:
        """Logits (B, 18)."""
        logits: Tensor = self.policy(self.trunk(observations), tasks)
        return logits


class ActorCritic(PolicyNetwork):
    """Logits and values; policy and value function share all but the last layer."""

    def __init__(self, trunk: Trunk | StateTrunk, num_tasks: int) -> None:
        super().__init__(trunk, num_tasks)
        self.value = TaskLinear(trunk.features, 1, num_tasks)

    def both(self, observations: Tensor, tasks: Tensor) -> tuple[Tensor, Tensor]:
        """Logits (B, 18) and values (B,) from one pass through the trunk."""
        features = self.trunk(observations)
        return self.policy(features, tasks), self.value(features, tasks).squeeze(1)


class Discriminator(nn.Module):
    """One logit for an observation and an action; high means expert-like."""

    def __init__(
        self,
        width: Width,
        image_shape: tuple[int, ...],
        num_tasks: int,
        batch_norm: bool = True,
    ) -> None:
        super().__init__()
        self.trunk = Trunk(width, image_shape, batch_norm, action_input=True)
        self.last = TaskLinear(self.trunk.features, 1, num_tasks)

    def forward(self, images: Tensor, actions: Tensor, tasks: Tensor) -> Tensor:
        """Logits (B,)."""
        logits: Tensor = self.last(self.trunk(images, actions), tasks)
        return logits.squeeze(1)
