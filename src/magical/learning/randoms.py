"""The random numbers of a training step: NumPy's on a CPU, a GPU's own on a GPU."""

import numpy as np
import torch
from torch import Tensor

from magical.learning.augment import augment, augment_on_device
from magical.learning.augmentations import Augmentations


class Randoms:
    """Random numbers where networks compute.

    On a CPU they are those of `rng` and on other devices those of a generator there, which is
    seeded from it: a step then neither waits for the host nor copies from it.

    Attributes:
        generators: the device's generators that are used, for CUDA graphs.
    """

    def __init__(self, device: str, rng: np.random.Generator | None = None) -> None:
        self._rng = rng or np.random.default_rng(0)
        self._device = device
        self.generators = [] if device == "cpu" else [torch.Generator(device)]
        if rng is not None:
            self.start(rng)

    def start(self, rng: np.random.Generator) -> None:
        """Continue with the numbers of another generator."""
        self._rng = rng
        for generator in self.generators:
            generator.manual_seed(int(rng.integers(2**63)))

    def uniform(self, size: int) -> Tensor:
        """Numbers from 0 to 1: (size,) float32."""
        for generator in self.generators:
            return torch.rand(size, device=self._device, generator=generator)
        return torch.from_numpy(self._rng.random(size, np.float32))

    def augment(self, images: Tensor, which: Augmentations) -> Tensor:
        """See `magical.learning.augment.augment`."""
        for generator in self.generators:
            return augment_on_device(images, which, generator)
        return augment(images, which, self._rng)
