"""One random stream for each rollout."""

import functools
import inspect
import zlib
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np


def rollout_stream(env_id: str, seed: int) -> tuple[int, int]:
    """The numbers that seed the random stream of a rollout that was reset with `seed`."""
    return seed, zlib.crc32(env_id.encode())


class RolloutRng(np.random.Generator):
    """The generator that policies get: each row of the batch has its own stream.

    The methods of `ROW_METHODS` with `size=B` or `size=(B, ...)` and scalar parameters take row i
    from rollout i's stream, so the numbers do not depend on which environments are stepped
    together. Any other call samples from one common stream.
    """

    def __init__(self, env_ids: Sequence[str], seeds: Sequence[int]) -> None:
        streams = list(map(rollout_stream, env_ids, seeds))
        super().__init__(np.random.PCG64([word for stream in streams for word in stream]))
        self._rows = [np.random.Generator(np.random.PCG64(stream)) for stream in streams]


def _by_rows(name: str) -> Callable[..., Any]:
    sample = getattr(np.random.Generator, name)
    signature = inspect.signature(sample)

    @functools.wraps(sample)
    def sample_rows(self: RolloutRng, *args: Any, **kwargs: Any) -> Any:
        given = signature.bind(self, *args, **kwargs).arguments
        given.pop("self")
        size = given.pop("size", None)
        shape = size if isinstance(size, tuple) else (size,)
        if shape[:1] != (len(self._rows),) or any(np.ndim(value) for value in given.values()):
            return sample(self, *args, **kwargs)
        return np.array([getattr(row, name)(size=shape[1:], **given) for row in self._rows])

    return sample_rows


ROW_METHODS = (
    "random",
    "uniform",
    "integers",
    "standard_normal",
    "normal",
    "gumbel",
    "exponential",
    "standard_exponential",
)
for _name in ROW_METHODS:
    setattr(RolloutRng, _name, _by_rows(_name))
