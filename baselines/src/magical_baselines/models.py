"""Policies, actor-critics and discriminators: a trunk and task-specific last layers.

Source: appendix B, Fig. 11; docs/specification.md, section 10.

A trunk maps observations to features; a last layer per task maps features to logits, values or
scores. Images are float (B, C, H, W) in [0, 1], which a trunk may map to [-1, 1]; state vectors are
float (B, size); `tasks` is int64 (B,), the position of each row's task in the configuration.
"""

import math
from itertools import chain

import torch
from torch import Tensor, nn
from torch.nn import functional

from magical.scene import NUM_ACTIONS
from magical_baselines.networks import find_network

EMBEDDING = 32  # size of the learnt embedding of an action (docs/specification.md, section 11)
# Inputs that an action adds to the first and the last linear layer, by how it is joined.
JOINED = {"none": (0, 0), "one-hot": (NUM_ACTIONS, 0), "embedding": (0, EMBEDDING)}
MEAN_BRIGHTNESS = 0.92  # of the tasks' frames, in [0, 1]
POLICY_GAIN = 0.01  # factor of the policy's last layer under `centred`: nearly uniform actions


class Trunk(nn.Module):
    """Maps observations to features: a network without its last layer.

    Images pass through the architecture's convolutions, are flattened, and pass through its linear
    layers. State vectors pass through the linear layers only. An action is joined as a one-hot
    vector to the flattened output of the convolutions, or as a learnt embedding to the input of the
    last linear layer (the second of two in Fig. 11).

    Attributes:
        num_features: the size of the output.
        map_shape: (C, H, W) of the convolutions' output, or (size,) of state vectors.
    """

    def __init__(
        self,
        network: str,
        input_shape: tuple[int, ...],
        *,
        batch_norm: bool = False,
        action_input: str = "none",
        num_features: int | None = None,
        pixel_range: tuple[float, float] = (0.0, 1.0),
    ) -> None:
        """Build the trunk of an architecture, by name, with PyTorch's initialisation.

        The input shape is (C, H, W) of images or (size,) of state vectors. `num_features` replaces
        the last linear layer's size, and images in [0, 1] are mapped to the pixel range.
        `action_input`, a key of `JOINED`, says how actions are joined.
        """
        super().__init__()
        architecture = find_network(network)
        hidden = architecture.HIDDEN
        if num_features is not None:
            hidden = (*hidden[:-1], num_features)
        self.convolutions = None
        self.map_shape = input_shape
        if len(input_shape) == 3:
            self.convolutions = architecture.make_convolutions(input_shape[0], batch_norm)
            self.convolutions.eval()  # leaves the statistics of batch norm alone
            with torch.no_grad():
                self.map_shape = tuple(self.convolutions(torch.zeros(1, *input_shape)).shape[1:])
            self.convolutions.train()
        self.action_input = action_input
        self.pixels = pixel_range
        joined = JOINED[action_input]
        inputs = [math.prod(self.map_shape), *hidden[:-1]]
        inputs[0] += joined[0]
        inputs[-1] += joined[1]
        pairs = [(nn.Linear(*sizes), nn.ReLU()) for sizes in zip(inputs, hidden, strict=True)]
        self.linear = nn.Sequential(*chain.from_iterable(pairs))
        self.embedding = nn.Embedding(NUM_ACTIONS, EMBEDDING) if joined[1] else None
        self.num_features = hidden[-1]
        # Convolutions are fastest with this memory layout; PyTorch's typed overloads lack it.
        self.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def forward(
        self, observations: Tensor, actions: Tensor | None = None, *, in_range: bool = False
    ) -> Tensor:
        """Features (B, num_features) of observations (B, ...), and of actions (B,) int64.

        `in_range`: `to_range` has already been applied to the observations.
        """
        flat = self.feature_map(observations, in_range=in_range).flatten(1)  # (B, C * H * W)
        linear: nn.Module = self.linear
        if self.action_input == "embedding":
            flat, linear = self.linear[:-2](flat), self.linear[-2:]  # the last layer and its ReLU
        if self.action_input != "none":
            assert actions is not None
            added = (
                functional.one_hot(actions, NUM_ACTIONS)  # (B, 18)
                if self.embedding is None
                else self.embedding(actions)  # (B, 32)
            )
            flat = torch.cat([flat, added.to(flat.dtype)], dim=1)
        features: Tensor = linear(flat)
        return features

    def feature_map(self, observations: Tensor, *, in_range: bool = False) -> Tensor:
        """The convolutions' output (B, C, H, W) for images; state vectors unchanged."""
        ranged = observations if in_range else self.to_range(observations)
        if self.convolutions is None:
            return ranged
        mapped: Tensor = self.convolutions(ranged)
        return mapped

    def to_range(self, observations: Tensor) -> Tensor:
        """Map images (B, C, H, W) in [0, 1] to this trunk's range; leave vectors unchanged."""
        low, high = self.pixels
        if self.convolutions is None or (low, high) == (0.0, 1.0):
            return observations
        return (observations * (high - low)).add_(low)


class TaskLinear(nn.Module):
    """A linear layer with separate weights for each task.

    The outputs for all tasks are computed, and each row's are selected: with at most eight tasks,
    this is cheaper than sorting rows, and shapes stay static.
    """

    def __init__(self, inputs: int, outputs: int, num_tasks: int) -> None:
        super().__init__()
        self.num_tasks = num_tasks
        self.linear = nn.Linear(inputs, outputs * num_tasks)

    def forward(self, features: Tensor, tasks: Tensor) -> Tensor:
        """Outputs (B, outputs) of features (B, inputs) for each row's task (B,); float32."""
        with torch.autocast(features.device.type, enabled=False):
            every: Tensor = self.linear(features.float())
        if self.num_tasks == 1:
            return every
        every = every.view(len(features), self.num_tasks, -1)
        index = tasks.view(-1, 1, 1).expand(-1, 1, every.shape[2])
        return every.gather(1, index).squeeze(1)


class PolicyNetwork(nn.Module):
    """A policy: logits of the 18 actions."""

    def __init__(self, trunk: Trunk, num_tasks: int) -> None:
        super().__init__()
        self.trunk = trunk
        self.policy = TaskLinear(trunk.num_features, NUM_ACTIONS, num_tasks)

    def forward(self, observations: Tensor, tasks: Tensor) -> Tensor:
        """Logits (B, 18)."""
        logits: Tensor = self.policy(self.trunk(observations), tasks)
        return logits


class ActorCritic(PolicyNetwork):
    """An actor-critic: logits and values; policy and value function share the trunk."""

    def __init__(self, trunk: Trunk, num_tasks: int) -> None:
        super().__init__(trunk, num_tasks)
        self.value = TaskLinear(trunk.num_features, 1, num_tasks)

    def logits_and_values(
        self, observations: Tensor, tasks: Tensor, *, in_range: bool = False
    ) -> tuple[Tensor, Tensor]:
        """Logits (B, 18) and values (B,) from one pass of the trunk; `in_range`: see `Trunk`."""
        features = self.trunk(observations, in_range=in_range)
        return self.policy(features, tasks), self.value(features, tasks).squeeze(1)


class Discriminator(nn.Module):
    """A discriminator: one logit per observation and action; high means expert-like."""

    def __init__(self, trunk: Trunk, num_tasks: int) -> None:
        super().__init__()
        self.trunk = trunk
        self.last = TaskLinear(trunk.num_features, 1, num_tasks)

    def forward(self, images: Tensor, actions: Tensor, tasks: Tensor) -> Tensor:
        """Logits (B,)."""
        logits: Tensor = self.last(self.trunk(images, actions), tasks)
        return logits.squeeze(1)


def init_normal(*layers: TaskLinear) -> None:
    """Initialise weights and biases from N(0, 1), as the published code does for last layers."""
    for layer in layers:
        nn.init.normal_(layer.linear.weight)
        nn.init.normal_(layer.linear.bias)


def centre(network: PolicyNetwork) -> None:
    """Initialise an image policy without batch norm so that it can tell frames apart.

    With PyTorch's initialisation, the difference between two frames, which are nearly white,
    shrinks to a thousandth in the features. He initialisation preserves it, the first convolution's
    biases cancel a uniform frame of mean brightness, and the initial policy is nearly uniform.
    """
    layers = [m for m in network.modules() if isinstance(m, nn.Conv2d | nn.Linear)]
    for layer in layers:
        nn.init.kaiming_normal_(layer.weight, nonlinearity="relu")
        if layer.bias is not None:
            nn.init.zeros_(layer.bias)
    with torch.no_grad():
        first = layers[0]
        # Another distribution's architecture may begin otherwise.
        if isinstance(first, nn.Conv2d) and first.bias is not None:
            low, high = network.trunk.pixels
            brightness = low + (high - low) * MEAN_BRIGHTNESS
            first.bias.copy_(-brightness * first.weight.flatten(1).sum(dim=1))
        network.policy.linear.weight.mul_(POLICY_GAIN)


def sample_actions(logits: Tensor, uniforms: Tensor) -> tuple[Tensor, Tensor]:
    """Sample actions by inverting the cumulative distribution.

    Args:
        logits: (B, 18).
        uniforms: (B,) random numbers, uniform in [0, 1).

    Returns:
        Actions (B,) int64 and their log-probabilities (B,) float32.
    """
    log_probs = logits.float().log_softmax(dim=1)
    cumulative = log_probs.exp().cumsum(dim=1)  # (B, 18)
    actions = (uniforms[:, None] * cumulative[:, -1:] >= cumulative).sum(dim=1)
    actions = actions.clamp_(max=logits.shape[1] - 1)
    return actions, log_probs.gather(1, actions[:, None]).squeeze(1)
