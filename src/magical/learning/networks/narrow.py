"""`light` with half the channels in its first two convolutions."""

from torch import nn

from magical.learning.networks.paper import stack_convolutions

CONVOLUTIONS = ((16, 5, 4), (32, 3, 2), (64, 3, 2))  # output channels, kernel size, stride
HIDDEN = (256,)


def make_convolutions(channels: int, batch_norm: bool) -> nn.Module:
    """A module from images (B, channels, 96, 96) to feature maps (B, 64, 6, 6)."""
    return stack_convolutions(channels, CONVOLUTIONS, batch_norm)
