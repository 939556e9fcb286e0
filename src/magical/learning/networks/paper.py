"""The network of Fig. 11 (appendix B; layer sizes in docs/specification.md, section 10)."""

from torch import nn

CONVOLUTIONS = ((64, 5, 1), *[(128, 3, 2)] * 4)  # output channels, kernel size, stride
HIDDEN = (256, 256)


def make_convolutions(channels: int, batch_norm: bool) -> nn.Module:
    """A module from images (B, channels, 96, 96) to feature maps (B, 128, 6, 6)."""
    return stack_convolutions(channels, CONVOLUTIONS, batch_norm)


def stack_convolutions(
    channels: int, layers: tuple[tuple[int, int, int], ...], batch_norm: bool
) -> nn.Sequential:
    """Convolutions as in Fig. 11: padded to keep size / stride, each followed by a ReLU.

    Args:
        channels: the input's channels.
        layers: output channels, kernel size and stride of each convolution.
        batch_norm: follow each ReLU with batch norm; the convolutions then have no bias.
    """
    modules: list[nn.Module] = []
    for out, kernel, stride in layers:
        modules += [
            nn.Conv2d(channels, out, kernel, stride, kernel // 2, bias=not batch_norm),
            nn.ReLU(),
        ]
        modules += [nn.BatchNorm2d(out)] if batch_norm else []
        channels = out
    return nn.Sequential(*modules)
