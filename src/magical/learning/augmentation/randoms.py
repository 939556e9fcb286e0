"""The random numbers of a training step: NumPy's on a CPU, a GPU's own on a GPU."""

import numpy as np
import torch
from torch import Tensor

from magical.learning.augmentation.augment import augment, augment_on_device
from magical.learning.augmentation.names import Augmentations


class Randoms:
    """Random numbers where networks compute.

    On a CPU they are those of `rng`; elsewhere those of a generator on the device, which is seeded
    from it: a step then neither waits for the host nor copies from it.
    """

    def __init__(self, device: str, rng: np.random.Generator | None = None) -> None:
        self._device = device
        self._generator = None if device == "cpu" else torch.Generator(device)
        self.start(rng or np.random.default_rng(0))

    @property
    def generators(self) -> list[torch.Generator]:
        """The device's generators that are used, for `GraphedStep`."""
        return [self._generator] if self._generator else []

    def start(self, rng: np.random.Generator) -> None:
        """Continue with the numbers of another generator."""
        self._rng = rng
        if self._generator:
            self._generator.manual_seed(int(rng.integers(2**63)))

    def uniform(self, size: int) -> Tensor:
        """Numbers from 0 to 1: (size,) float32."""
        if self._generator:
            return torch.rand(size, device=self._device, generator=self._generator)
        return torch.from_numpy(self._rng.random(size, np.float32))

    def augment(self, images: Tensor, which: Augmentations) -> Tensor:
        """See `magical.learning.augmentation.augment.augment`."""
        if self._generator:
            return augment_on_device(images, which, self._generator)
        return augment(images, which, self._rng)
