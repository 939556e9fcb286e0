"""Checks of the arguments of a vector environment."""

import operator
import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from magical.envs.env import time_limit_error
from magical.errors import ResetNeededError, UnknownNameError
from magical.messages import quoted

MAX_TIMEOUT = 1e6  # s, the longest that one system call can wait


def check_no_time_limit(options: Mapping[str, Any]) -> None:
    """Raise `InvalidConfigError` if the options of `make_vec` include `max_episode_steps`."""
    if "max_episode_steps" in options:
        raise time_limit_error(options["max_episode_steps"])


def parse_autoreset_mode(mode: str | AutoresetMode) -> AutoresetMode:
    """Parse an autoreset mode, or a value such as "SameStep"; raises `UnknownNameError`."""
    try:
        return AutoresetMode(mode)
    except ValueError as error:
        raise UnknownNameError(
            f"autoreset mode {quoted(mode)} is unknown; expected one of: "
            f"{', '.join(each.value for each in AutoresetMode)}"
        ) from error


def checked_mask(name: str, mask: Any, num_envs: int) -> NDArray[np.bool_]:
    """A mask of sub-environments as bool (N,), all True for None; raises `ValueError`."""
    if mask is None:
        return np.ones(num_envs, np.bool_)
    array = np.asarray(mask)
    if array.shape != (num_envs,) or array.dtype != np.bool_ or not array.any():
        raise ValueError(
            f"{name}: expected bool ({num_envs},) with at least one True, found {quoted(mask)}"
        )
    return array


def checked_seeds(seed: int | Sequence[int | None] | None, num_envs: int) -> list[int | None]:
    """One seed for each sub-environment: `seed + i`, or a list's entries.

    Raises `ValueError`.
    """
    if seed is None:
        return [None] * num_envs
    entries: Any = seed
    seeds: list[int | None] = []
    with suppress(TypeError, ValueError):  # neither an integer nor a list of them
        if np.ndim(entries) == 0:
            seeds = [operator.index(entries) + i for i in range(num_envs)]
        else:
            seeds = [None if s is None else operator.index(s) for s in entries]
    if len(seeds) != num_envs or any(s is not None and s < 0 for s in seeds):
        raise ValueError(
            f"seed: expected a non-negative integer, {num_envs} of them, or None, "
            f"found {quoted(seed)}"
        )
    return seeds


def check_timeout(timeout: float | None, workers: int) -> None:
    """Raise `ValueError` for a timeout out of range, without workers or on Windows."""
    if timeout is None:
        return
    number = isinstance(timeout, int | float) and not isinstance(timeout, bool)
    if not number or not 0 < timeout <= MAX_TIMEOUT:
        raise ValueError(
            f"timeout: expected seconds up to {MAX_TIMEOUT:g}, or None, found {quoted(timeout)}"
        )
    if not workers or os.name == "nt":
        raise ValueError(
            f"timeout: expected None without workers and on Windows, found {quoted(timeout)}"
        )


def require_episodes(what: str, running: NDArray[np.bool_], env_ids: Sequence[str]) -> None:
    """Raise `ResetNeededError`, naming the sub-environments without an episode, if any."""
    if not running.all():
        rows = np.flatnonzero(~running).tolist()
        names = ", ".join(f"{row} ({env_ids[row]})" for row in rows[:5])
        raise ResetNeededError(
            f"{what}: expected a running episode in every environment, found none in {len(rows)} "
            f"of {len(env_ids)}: {names}{', ...' if len(rows) > 5 else ''}; call reset() first"
        )
