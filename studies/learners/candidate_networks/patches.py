"""Patches of 8 x 8 pixels, then convolutions of 3 x 3: the first layer's stride is 8."""

from torch import nn

from magical.learning.networks.paper import stack_convolutions

CONVOLUTIONS = ((64, 8, 8), (64, 3, 1), (64, 3, 2))  # output channels, kernel size, stride
HIDDEN = (256,)


def make_convolutions(channels: int, batch_norm: bool) -> nn.Module:
    """Images (B, channels, 96, 96) to feature maps (B, 64, 7, 7)."""
    return stack_convolutions(channels, CONVOLUTIONS, batch_norm)
