"""Vector environments: which observations the caller owns."""

from typing import Any

import numpy as np
import pytest

from magical.envs.vector import MagicalVectorEnv
from magical.observe.arrays import copy_arrays

IDS = ("magical/FindDupe-TestAll-v0", "magical/FindDupe-Demo-v0", "magical/FindDupe-TestShape-v0")


def vector(
    env_ids: Any = IDS, workers: int = 0, observation: Any = "state", **options: Any
) -> MagicalVectorEnv:
    return MagicalVectorEnv(env_ids, workers=workers, observation=observation, **options)


@pytest.mark.parametrize("observation", ["state", "LoRes4A", "LoResStack"])
@pytest.mark.parametrize("workers", [0, 2])
def test_copies_do_not_change_after_they_are_returned(observation: str, workers: int) -> None:
    envs = vector(IDS[:2], workers, observation, horizon=4)
    viewing = vector(IDS[:2], 0, observation, horizon=4, copy=False)
    kept, expected = [envs.reset(seed=0)[0]], [copy_arrays(viewing.reset(seed=0)[0])]
    inactive_second = np.array([True, False])
    for step, actions in enumerate(np.random.default_rng(0).integers(0, 18, (8, 2))):
        active = inactive_second if step == 2 else None
        kept.append(envs.step(actions, active)[0])
        expected.append(copy_arrays(viewing.step(actions, active)[0]))
    np.testing.assert_equal(kept, expected)
    envs.close()
    np.testing.assert_equal(kept, expected)


def test_arrays_for_copies_are_reused_once_the_caller_has_released_them() -> None:
    envs = vector(IDS, 0, "LoRes4A")
    envs.reset(seed=0)
    held = [envs.step([1, 1, 1])[0][1, 5:7] for _ in range(3)]
    addresses = {view.ctypes.data for view in held}
    assert len(addresses) == 3
    assert envs._copies.choose() == -1
    fourth = envs.step([1, 1, 1])[0]
    assert fourth.base is None
    del held[1]
    assert envs._copies.choose() == 1
    before = [view.copy() for view in held]
    for _ in range(3):
        assert envs.step([2, 2, 2])[0][1, 5:7].ctypes.data in addresses
    np.testing.assert_equal(held, before)


def test_without_copies_observations_are_the_buffers() -> None:
    envs = vector(copy=False)
    first, _ = envs.reset(seed=0)
    kept = first.copy()
    assert envs.step([1, 1, 1])[0] is first
    assert np.any(first != kept)
