"""One encoder of three layers for every frame; only the linear layers see the whole stack."""

from torch import nn

from magical.learning.networks import find_network
from magical.learning.networks.paper import stack_convolutions

HIDDEN = (256,)
LAYERS = ((16, 5, 4), (32, 3, 2), (32, 3, 2))  # output channels, kernel size, stride


def make_convolutions(channels: int, batch_norm: bool) -> nn.Module:
    """Images (B, channels, 96, 96) to feature maps (B, 32 * frames, 6, 6)."""
    frames = find_network("frames")
    encoder: nn.Module = frames.FrameEncoder(stack_convolutions(3, LAYERS, batch_norm))  # type: ignore[attr-defined]
    return encoder
