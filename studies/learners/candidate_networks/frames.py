"""One encoder for every frame: a layer of stride 4 that all frames of a stack share."""

from torch import Tensor, nn

from magical.learning.networks.paper import stack_convolutions

HIDDEN = (256,)
RGB = 3


class FrameEncoder(nn.Module):
    """A layer on every frame by itself; their feature maps are stacked."""

    def __init__(self, layer: nn.Module) -> None:
        super().__init__()
        self.layer = layer

    def forward(self, images: Tensor) -> Tensor:
        """(B, 3 * frames, H, W) to (B, frames * channels, H', W')."""
        batch, channels, height, width = images.shape
        frames = images.reshape(batch * (channels // RGB), RGB, height, width)
        maps: Tensor = self.layer(frames)
        return maps.reshape(batch, -1, *maps.shape[2:])


def make_convolutions(channels: int, batch_norm: bool) -> nn.Module:
    """Images (B, channels, 96, 96) to feature maps (B, 64, 6, 6)."""
    encoder = FrameEncoder(stack_convolutions(RGB, ((16, 5, 4),), batch_norm))
    rest = stack_convolutions(16 * channels // RGB, ((64, 3, 2), (64, 3, 2)), batch_norm)
    return nn.Sequential(encoder, *rest)
