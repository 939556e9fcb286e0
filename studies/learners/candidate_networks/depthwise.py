"""Depthwise separable convolutions (Howard et al., "MobileNets", 2017) behind a stride of 4."""

from torch import nn

HIDDEN = (256,)


def make_convolutions(channels: int, batch_norm: bool) -> nn.Module:
    """Images (B, channels, 96, 96) to feature maps (B, 128, 6, 6)."""
    modules: list[nn.Module] = [nn.Conv2d(channels, 32, 5, 4, 2), nn.ReLU()]
    modules += [nn.BatchNorm2d(32)] if batch_norm else []
    for inner, out in ((32, 64), (64, 128)):
        modules += [nn.Conv2d(inner, inner, 3, 2, 1, groups=inner), nn.Conv2d(inner, out, 1)]
        modules += [nn.ReLU()]
        modules += [nn.BatchNorm2d(out)] if batch_norm else []
    return nn.Sequential(*modules)
