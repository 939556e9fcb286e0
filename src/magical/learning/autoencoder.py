"""The autoencoder of apprenticeship learning: features of observations and actions (appendix B).

The encoder is the discriminator's network with its last layer removed and the one before it made
32 wide. The decoder is that of docs/specification.md, section 10.
"""

from pathlib import Path

import numpy as np
import torch
from PIL import Image
from torch import Tensor, nn

from magical.files import write_atomically
from magical.learning.models import Trunk
from magical.scene import NUM_ACTIONS

FEATURES = 32
HIDDEN = 128
START = (64, 6, 6)  # channels, rows, columns that the decoder's convolutions start from
DOUBLINGS = ((64, 64), (64, 32), (32, 32), (32, None))  # output channels; None: the image's
SIZE = START[1] * 2 ** len(DOUBLINGS)  # pixels


class Autoencoder(nn.Module):
    """Encodes images (B, C, 96, 96) and actions (B,) as features (B, 32), and decodes them."""

    def __init__(self, network: str, image_shape: tuple[int, ...]) -> None:
        super().__init__()
        assert image_shape[1:] == (SIZE, SIZE)
        self.encoder = Trunk(
            network, image_shape, batch_norm=True, action_input="one-hot", num_features=FEATURES
        )
        self.hidden = nn.Sequential(
            nn.Linear(FEATURES, HIDDEN), nn.ReLU(), nn.Linear(HIDDEN, HIDDEN), nn.ReLU()
        )
        self.action = nn.Linear(HIDDEN, NUM_ACTIONS)
        self.image = _image_decoder(image_shape[0])

    def forward(self, images: Tensor, actions: Tensor) -> tuple[Tensor, Tensor]:
        """Reconstructed images (B, C, 96, 96) and logits of actions (B, 18)."""
        hidden = self.hidden(self.encoder(images, actions))
        return self.image(hidden), self.action(hidden)


def _image_decoder(channels: int) -> nn.Sequential:
    layers: list[nn.Module] = [nn.Linear(HIDDEN, int(np.prod(START))), nn.Unflatten(1, START)]
    inputs = START[0]
    for first, second in DOUBLINGS:
        layers += [
            nn.Upsample(scale_factor=2, mode="nearest"),
            nn.Conv2d(inputs, first, 3, padding=1),
            nn.ReLU(),
            nn.Conv2d(first, second or channels, 3, padding=1),
        ]
        layers += [nn.ReLU()] if second else []
        inputs = second or channels
    return nn.Sequential(*layers)


def save_reconstructions(path: Path, images: Tensor, reconstructed: Tensor) -> None:
    """Write a PNG of the newest frame of each stack (B, C, H, W) in [0, 1], originals above."""
    rows = [torch.cat(list(stacks[:, -3:]), dim=2) for stacks in (images, reconstructed)]
    both = torch.cat(rows, dim=1).float().clamp(0.0, 1.0).mul(255.0).round()  # (3, 2H, B * W)
    pixels = both.to(torch.uint8).permute(1, 2, 0).cpu().numpy()
    with write_atomically(path) as file:
        Image.fromarray(pixels).save(file, format="PNG")
