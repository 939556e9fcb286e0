"""Fixed seeds for rollouts, and one random stream for each rollout."""

import functools
import inspect
import zlib
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

FIRST_SEED = 1_000_000_000  # evaluation's own range: nothing else in the package draws from it
SEEDS_PER_SWEEP = 1_000_000


def rollout_seed(rollout: int, seed: int = 0) -> int:
    """The seed that rollout number `rollout` of every environment is reset with.

    It depends on nothing else, so all policies meet the same scenes. `seed` chooses another set.
    """
    return FIRST_SEED + SEEDS_PER_SWEEP * seed + rollout


def rollout_stream(env_id: str, rollout_seed: int) -> tuple[int, int]:
    """What seeds a rollout's own stream of random numbers, different for every environment."""
    return rollout_seed, zlib.crc32(env_id.encode())


class RolloutRng(np.random.Generator):
    """The generator that policies get: every row of the batch has a stream of its own.

    Draws of `ROW_DRAWS` with `size=B` or `size=(B, ...)` and scalar parameters take row i from
    rollout i's stream. So they depend neither on how many worlds run side by side nor on which
    others do. Any other draw comes from one common stream.
    """

    def __init__(self, env_ids: Sequence[str], rollout_seeds: Sequence[int]) -> None:
        streams = list(map(rollout_stream, env_ids, rollout_seeds))
        super().__init__(np.random.PCG64([word for stream in streams for word in stream]))
        self._rows = [np.random.Generator(np.random.PCG64(stream)) for stream in streams]


def _by_rows(name: str) -> Callable[..., Any]:
    draw = getattr(np.random.Generator, name)
    signature = inspect.signature(draw)

    @functools.wraps(draw)
    def draw_rows(self: RolloutRng, *args: Any, **kwargs: Any) -> Any:
        given = signature.bind(self, *args, **kwargs).arguments
        given.pop("self")
        size = given.pop("size", None)
        shape = size if isinstance(size, tuple) else (size,)
        if shape[:1] != (len(self._rows),) or any(np.ndim(value) for value in given.values()):
            return draw(self, *args, **kwargs)
        return np.array([getattr(row, name)(size=shape[1:], **given) for row in self._rows])

    return draw_rows


ROW_DRAWS = (
    "random",
    "uniform",
    "integers",
    "standard_normal",
    "normal",
    "gumbel",
    "exponential",
    "standard_exponential",
)
for _name in ROW_DRAWS:
    setattr(RolloutRng, _name, _by_rows(_name))
