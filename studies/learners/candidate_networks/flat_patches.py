"""`light` whose first layer takes patches of 4 x 4 pixels that do not overlap."""

from torch import nn

from magical.learning.networks.paper import stack_convolutions

CONVOLUTIONS = ((32, 4, 4), (64, 3, 2), (64, 3, 2))  # output channels, kernel size, stride
HIDDEN = (256,)


def make_convolutions(channels: int, batch_norm: bool) -> nn.Module:
    """Images (B, channels, 96, 96) to feature maps (B, 64, 7, 7)."""
    return stack_convolutions(channels, CONVOLUTIONS, batch_norm)
