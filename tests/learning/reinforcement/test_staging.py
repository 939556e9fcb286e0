"""Copies through pinned memory, with plain memory in its place."""

from typing import Any

import pytest
import torch
from torch import Tensor

from magical.learning.reinforcement.staging import SLOTS, Staging


def test_on_a_cpu_it_is_a_copy() -> None:
    target = torch.zeros(3)
    Staging("cpu").copy(torch.ones(3), target)
    assert target.tolist() == [1.0, 1.0, 1.0]


def test_slots_have_the_source_s_layout_and_are_used_in_turn() -> None:
    made: list[Tensor] = []

    def empty(like: Tensor) -> Tensor:
        made.append(torch.empty_strided(like.shape, like.stride(), dtype=like.dtype))
        return made[-1]

    staging = Staging("cpu", empty, on=True)
    frames = torch.zeros(2, 4, 4, 3, dtype=torch.uint8).permute(0, 3, 1, 2)
    for number in range(5):
        frames.fill_(number)
        target = torch.zeros(frames.shape, dtype=torch.uint8)
        staging.copy(frames, target)
        assert bool((target == number).all())
        frames.fill_(99)  # the source may change at once
    assert len(made) == SLOTS
    assert all(memory.stride() == frames.stride() for memory in made)
    assert {int(memory.flatten()[0]) for memory in made} == {3, 4}
    staging.copy(torch.zeros(7), torch.zeros(7))
    assert len(made) == SLOTS + 1


def test_both_slots_of_a_shape_hold_the_newest_copies() -> None:
    staging = Staging("cpu", torch.empty_like, on=True)
    targets = [torch.zeros(2) for _ in range(4)]
    for number, target in enumerate(targets):
        staging.copy(torch.full((2,), float(number)), target)
    assert [target[0].item() for target in targets] == [0.0, 1.0, 2.0, 3.0]


def test_without_pinned_memory_copies_go_through_ordinary_memory(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    plain = torch.empty_strided

    def failing(*arguments: Any, pin_memory: bool = False, **options: Any) -> Tensor:
        if pin_memory:
            raise RuntimeError("cannot lock memory")
        return plain(*arguments, **options)

    monkeypatch.setattr(torch, "empty_strided", failing)
    target = torch.zeros(3)
    with pytest.warns(UserWarning, match="no pinned memory.*cannot lock memory"):
        Staging("cpu", on=True).copy(torch.ones(3), target)
    assert target.tolist() == [1.0, 1.0, 1.0]
