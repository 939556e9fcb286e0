"""Batches made ahead in a thread."""

import threading
from itertools import count

import pytest
import torch

from magical_baselines.data.prefetch import prefetch


def alive() -> int:
    return sum(thread.name.startswith("batches") for thread in threading.enumerate())


@pytest.mark.parametrize("ahead", [True, False])
def test_batches_come_in_order(ahead: bool) -> None:
    with prefetch(lambda n: n * n, range(20), ahead) as batches:
        assert list(batches) == [n * n for n in range(20)]


def test_errors_reach_the_learner_and_the_thread_ends() -> None:
    def make(number: int) -> int:
        if number == 3:
            raise ValueError("no batch 3")
        return number

    with prefetch(make, range(9), True) as batches:
        assert [next(batches) for _ in range(3)] == [0, 1, 2]
        with pytest.raises(ValueError, match="no batch 3"):
            next(batches)
    assert alive() == 0


def test_leaving_early_ends_the_thread() -> None:
    with prefetch(lambda n: n, count(), True) as batches:
        assert next(batches) == 0
    assert alive() == 0


def test_the_thread_computes_alone_and_the_learner_keeps_its_cores() -> None:
    torch.set_num_threads(2)
    with prefetch(lambda _: torch.get_num_threads(), range(2), True) as batches:
        assert list(batches) == [1, 1]
        assert torch.get_num_threads() == 2
    assert torch.get_num_threads() == 2
    torch.set_num_threads(1)
