"""The autoencoder for apprenticeship learning: features of observations and actions (appendix B).

The encoder is the discriminator's network with its last layer removed and the layer before it set
to 32 units. The decoder is specified in docs/specification.md, section 10.
"""

from pathlib import Path
from typing import Literal

import numpy as np
import torch
from PIL import Image
from torch import Tensor, nn
from torch.nn import functional

from magical.files import write_atomically
from magical.scene import NUM_ACTIONS
from magical_baselines.config import NetworkSettings
from magical_baselines.models import Trunk

FEATURES = 32
HIDDEN = 128
START = (64, 6, 6)  # channels, rows, columns of the input of the decoder's convolutions
DOUBLINGS = ((64, 64), (64, 32), (32, 32), (32, None))  # output channels; None: the image's
SIZE = START[1] * 2 ** len(DOUBLINGS)  # pixels


class Autoencoder(nn.Module):
    """Encodes images (B, C, 96, 96) and actions (B,) as features (B, 32), and decodes them.

    Attributes:
        mean_image: (C, 96, 96), the image added to the decoder's output; initially where the
            encoder's pixels are 0, which is mid grey by the published code's conventions.
    """

    def __init__(
        self,
        settings: NetworkSettings,
        image_shape: tuple[int, ...],
        *,
        linear_features: bool = False,
    ) -> None:
        """Build an autoencoder, with PyTorch's initialisation.

        Args:
            settings: the encoder's. Under the published code's conventions, the image decoder has
                another linear layer, batch norm before each ReLU, and mirrored borders. The
                decoded pixels are in [0, 1] whatever the range of the encoder's.
            image_shape: (C, 96, 96).
            linear_features: leave out the ReLU after the encoder's last layer.
        """
        super().__init__()
        self.encoder = Trunk(
            settings.network,
            image_shape,
            batch_norm=True,
            action_input=settings.action_input,
            num_features=FEATURES,
            pixel_range=settings.pixel_range,
        )
        if linear_features:
            self.encoder.linear[-1] = nn.Identity()
        self.hidden = nn.Sequential(
            nn.Linear(FEATURES, HIDDEN), nn.ReLU(), nn.Linear(HIDDEN, HIDDEN), nn.ReLU()
        )
        self.action = nn.Linear(HIDDEN, NUM_ACTIONS)
        start = nn.Linear(HIDDEN, int(np.prod(START)))
        published = settings.published
        self.start = nn.Sequential(nn.Linear(HIDDEN, HIDDEN), start) if published else start
        self.image = _image_decoder(image_shape[0], published)
        self.scale = 0.5 if published else 1.0  # from the encoder's range of pixels to [0, 1]
        self.mean_image: Tensor
        self.register_buffer("mean_image", torch.full(image_shape, 0.5 if published else 0.0))
        # Convolutions are fastest with this memory layout; PyTorch's typed overloads lack it.
        self.image.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def forward(self, images: Tensor, actions: Tensor) -> tuple[Tensor, Tensor]:
        """Return reconstructed images (B, C, 96, 96) and logits of the actions (B, 18)."""
        hidden = self.hidden(self.encoder(images, actions))
        start = self.start(hidden).view(-1, *START)
        difference = self.image(start.contiguous(memory_format=torch.channels_last))
        return self.scale * difference.float() + self.mean_image, self.action(hidden)


def _image_decoder(channels: int, published: bool) -> nn.Sequential:
    """A module from feature maps (B, 64, 6, 6) to images (B, channels, 96, 96)."""
    borders: Literal["reflect", "zeros"] = "reflect" if published else "zeros"
    layers: list[nn.Module] = []
    inputs = START[0]
    for doubled, last in DOUBLINGS:
        layers.append(nn.Upsample(scale_factor=2, mode="nearest"))
        for outputs in (doubled, last):
            convolution = nn.Conv2d(inputs, outputs or channels, 3, padding=1, padding_mode=borders)
            layers.append(convolution)
            if outputs:
                layers += [nn.BatchNorm2d(outputs)] if published else []
                layers.append(nn.ReLU())
                inputs = outputs
    return nn.Sequential(*layers)


def autoencoder_loss(
    images: Tensor, actions: Tensor, reconstructed: Tensor, logits: Tensor
) -> tuple[Tensor, Tensor]:
    """Return the terms of the loss: mean squared image error and cross-entropy of the actions."""
    error = functional.mse_loss(reconstructed.float(), images)
    return error, functional.cross_entropy(logits.float(), actions)


def save_reconstructions(path: Path, images: Tensor, reconstructed: Tensor) -> None:
    """Write a PNG of the newest frame of each stack (B, C, H, W) in [0, 1], originals on top."""
    rows = [torch.cat(list(stacks[:, -3:]), dim=2) for stacks in (images, reconstructed)]
    both = torch.cat(rows, dim=1).float().clamp(0.0, 1.0).mul(255.0).round()  # (3, 2H, B * W)
    pixels = both.to(torch.uint8).permute(1, 2, 0).cpu().numpy()
    with write_atomically(path) as file:
        Image.fromarray(pixels).save(file, format="PNG")
