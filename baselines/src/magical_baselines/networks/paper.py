"""The network of Fig. 11 (appendix B; layer sizes in docs/specification.md, section 10)."""

from dataclasses import dataclass

from torch import nn


@dataclass(frozen=True)
class ConvolutionStack:
    """Convolutions as in Fig. 11: padded to keep size / stride, each followed by a ReLU.

    Attributes:
        layers: output channels, kernel size and stride of each convolution.
        HIDDEN: the sizes of the linear layers that follow.
    """

    layers: tuple[tuple[int, int, int], ...]
    HIDDEN: tuple[int, ...]

    def make_convolutions(self, channels: int, batch_norm: bool) -> nn.Module:
        """A module from images (B, channels, H, W) to feature maps (B, C, h, w).

        With `batch_norm`, it follows each ReLU, and the convolutions have no bias.
        """
        modules: list[nn.Module] = []
        for out, kernel, stride in self.layers:
            modules += [
                nn.Conv2d(channels, out, kernel, stride, kernel // 2, bias=not batch_norm),
                nn.ReLU(),
            ]
            modules += [nn.BatchNorm2d(out)] if batch_norm else []
            channels = out
        return nn.Sequential(*modules)


NETWORK = ConvolutionStack(((64, 5, 1), *[(128, 3, 2)] * 4), (256, 256))
