"""Random streams of a run: every draw is a pure function of the seed, its purpose and its number.

No generator's state has to be saved, and batches can be prepared ahead or out of turn: batch 1,000
is the same batch whether the run was resumed at 999 or not.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from enum import IntEnum

import numpy as np
import torch


class Purpose(IntEnum):
    """What a stream is for. Numbers are part of what makes a run repeatable: never reuse one."""

    DEMONSTRATIONS = 0
    WEIGHTS = 1
    BATCHES = 2
    ENVIRONMENTS = 3
    ACTIONS = 4
    MINIBATCHES = 5
    DISCRIMINATOR = 6
    PRETRAINING = 7


def stream(seed: int, purpose: Purpose, number: int = 0) -> np.random.Generator:
    """The generator of one purpose's draw number `number`."""
    return np.random.default_rng((seed, purpose, number))


@contextmanager
def seeded_weights(seed: int, number: int = 0) -> Iterator[None]:
    """Inside, PyTorch's own first weights follow from the seed; outside, nothing has changed."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(int(stream(seed, Purpose.WEIGHTS, number).integers(2**63)))
        yield
