"""A network: one linear layer on patches of 16 x 16 pixels, then a hidden layer."""

from torch import nn

HIDDEN = (64,)


def make_convolutions(channels: int, batch_norm: bool) -> nn.Module:
    """Images (B, channels, 96, 96) to feature maps (B, 32, 6, 6); there is nothing to normalise."""
    return nn.Sequential(nn.Conv2d(channels, 32, kernel_size=16, stride=16), nn.ReLU())
