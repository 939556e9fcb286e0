"""A run's random streams: a generator is a pure function of the seed, its purpose and a number.

No generator state has to be saved, and batches can be prepared ahead or out of order: batch 1,000
is the same whether or not the run was resumed at 999.
"""

import threading
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from enum import IntEnum

import numpy as np
import torch

# Guards PyTorch's global generator: while one thread initialises a network, runs in others wait.
_lock = threading.RLock()


class Purpose(IntEnum):
    """What a stream is for. Runs are reproducible only if no number ever changes its meaning."""

    DEMONSTRATIONS = 0
    INIT = 1
    BATCHES = 2
    ENVIRONMENTS = 3
    ACTIONS = 4
    MINIBATCHES = 5
    DISCRIMINATOR = 6
    PRETRAINING = 7
    NOISE = 8
    PROGRAMS = 9


def stream(seed: int, purpose: Purpose, number: int = 0) -> np.random.Generator:
    """The generator for `number` (a batch, an update, ...) of a purpose."""
    return np.random.default_rng((seed, purpose, number))


def seed_torch(seed: int, purpose: Purpose, number: int = 0) -> None:
    """Seed PyTorch's global generators, of the CPU and the GPUs, from a stream."""
    value = int(stream(seed, purpose, number).integers(2**63))
    # `torch.manual_seed` also records its call stack for each kind of device not in use.
    with _lock:
        torch.default_generator.manual_seed(value)
        if torch.cuda.is_available():
            torch.cuda.manual_seed_all(value)


def restored_generators(device: str = "cpu") -> AbstractContextManager[None]:
    """Context manager that restores PyTorch's global generators, of CPU and device, on exit."""
    # Without device numbers, all GPUs of the machine would be initialised.
    return torch.random.fork_rng([torch.cuda.current_device()] if device == "cuda" else [])


@contextmanager
def seeded_init(seed: int, number: int = 0) -> Iterator[None]:
    """Context manager in which PyTorch initialises network `number` from the seed."""
    with _lock, restored_generators():
        seed_torch(seed, Purpose.INIT, number)
        yield
