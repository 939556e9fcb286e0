"""The small residual network of Espeholt et al., "IMPALA", ICML 2018 (without its LSTM)."""

import torch
from torch import Tensor, nn

HIDDEN = (256,)


class Residual(nn.Module):
    """Two convolutions, whose result is added to their input."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            nn.ReLU(),
            nn.Conv2d(channels, channels, 3, padding=1),
            nn.ReLU(),
            nn.Conv2d(channels, channels, 3, padding=1),
        )

    def forward(self, maps: Tensor) -> Tensor:
        return torch.add(maps, self.layers(maps))


def make_convolutions(channels: int, batch_norm: bool) -> nn.Module:
    """Images (B, channels, 96, 96) to feature maps (B, 32, 12, 12)."""
    modules: list[nn.Module] = []
    for out in (16, 32, 32):
        modules += [nn.Conv2d(channels, out, 3, padding=1), nn.MaxPool2d(3, 2, 1)]
        modules += [nn.BatchNorm2d(out)] if batch_norm else []
        modules += [Residual(out), Residual(out)]
        channels = out
    return nn.Sequential(*modules, nn.ReLU())
