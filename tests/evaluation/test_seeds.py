"""Fixed seeds, and random streams that do not depend on the batch."""

from typing import Any

import numpy as np
import pytest

from magical.envs.seeds import evaluation_seed
from magical.evaluation.seeds import ROW_METHODS, RolloutRng, rollout_stream


def test_a_rollouts_stream_is_the_same_in_all_versions() -> None:
    assert rollout_stream("magical/FindDupe-Demo-v0", 7) == (7, 2_007_158_634)
    assert rollout_stream("magical/FindDupe-TestAll-v0", 7) == (7, 1_583_955_812)


def test_seeds_depend_on_the_rollout_and_the_set_alone() -> None:
    assert [evaluation_seed(i) for i in range(3)] == [1_000_000_000, 1_000_000_001, 1_000_000_002]
    assert evaluation_seed(3, seed=2) == 1_002_000_003


@pytest.mark.parametrize("name", ROW_METHODS)
@pytest.mark.parametrize("rest", [(), (18,)])
def test_a_row_samples_the_same_in_any_batch(name: str, rest: tuple[int, ...]) -> None:
    parameters = (2**40,) if name == "integers" else ()
    large, small = RolloutRng("abab", [5, 6, 7, 8]), RolloutRng("ab", [7, 4])
    for _ in range(3):
        many = getattr(large, name)(*parameters, size=(4, *rest))
        few = getattr(small, name)(*parameters, size=(2, *rest))
        assert many.shape == (4, *rest)
        np.testing.assert_array_equal(many[2], few[0])
        assert not np.array_equal(many[0], many[1])


def test_sizes_may_be_plain_numbers_and_positional() -> None:
    first, second = RolloutRng("ab", [1, 2]), RolloutRng("ab", [1, 2])
    np.testing.assert_array_equal(first.integers(0, 18, 2), second.integers(18, size=(2,)))
    one, other = RolloutRng("ab", [1, 1]).random((2, 5))  # environments share no stream
    assert not set(one) & set(other)


@pytest.mark.parametrize(
    "sample",
    [
        lambda rng: rng.random(),
        lambda rng: rng.random(3),
        lambda rng: rng.random(size=()),
        lambda rng: rng.normal(np.zeros(2)),
        lambda rng: rng.normal(np.zeros(2), size=2),
        lambda rng: rng.integers([3, 4], size=2),
        lambda rng: rng.random(2, out=np.empty(2)),
        lambda rng: rng.choice(18, size=2),
    ],
)
def test_other_samples_come_from_the_common_stream(sample: Any) -> None:
    words = [*rollout_stream("a", 1), *rollout_stream("b", 2)]
    common = np.random.Generator(np.random.PCG64(words))
    np.testing.assert_array_equal(sample(RolloutRng("ab", [1, 2])), sample(common))
