"""The network of Mnih et al., "Human-level control through deep reinforcement learning", 2015."""

from torch import nn

from magical.learning.networks.paper import stack_convolutions

CONVOLUTIONS = ((32, 8, 4), (64, 4, 2), (64, 3, 1))  # output channels, kernel size, stride
HIDDEN = (512,)


def make_convolutions(channels: int, batch_norm: bool) -> nn.Module:
    """Images (B, channels, 96, 96) to feature maps (B, 64, 13, 13)."""
    return stack_convolutions(channels, CONVOLUTIONS, batch_norm)
