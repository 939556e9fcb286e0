"""Behavioural cloning with memory: windows, what is attended to, and what a policy remembers."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from torch import Tensor

from baselines.tests.conftest import TASKS, picture_demo
from baselines.tests.tiny_runs import CPU
from magical.observe import PRESETS
from magical.scene import NOOP
from magical_baselines.algorithms.transformer_bc import (
    WIDTH,
    MemoryNetwork,
    MemoryPolicy,
    TransformerBCConfig,
    make_policy,
    memory_losses,
    sample_windows,
)
from magical_baselines.augmentation.augment import to_unit
from magical_baselines.data import ExpertData

WINDOW = 4
ID = "magical/MoveToCorner-Demo-v0"


def config(**settings: Any) -> TransformerBCConfig:
    made = {"tasks": TASKS, "demos": "", "window": WINDOW, "augment": "none", **settings}
    return TransformerBCConfig.preset("quick", **made)


def logits(
    network: MemoryNetwork, tokens: Tensor, before: Tensor, exist: Tensor, tasks: Any = (0, 0)
) -> Tensor:
    with torch.no_grad():
        return network.logits(tokens, before, exist, torch.tensor(tasks[: len(tokens)]))


@pytest.fixture
def inputs() -> tuple[Tensor, Tensor, Tensor]:
    """Two windows: whole, and with two steps before the start."""
    generator = torch.Generator().manual_seed(0)
    tokens = torch.randn(2, WINDOW, WIDTH, generator=generator)
    before = torch.randint(18, (2, WINDOW), generator=generator)
    exist = torch.tensor([[True] * WINDOW, [False, False, True, True]])
    return tokens, before, exist


def test_windows_end_at_samples_and_begin_at_the_demonstrations() -> None:
    actions = {"MoveToCorner": [3, 0, 4, 5, 9, 6], "MoveToRegion": [7, 8, 10, 0, 11]}
    pairs = [(task, picture_demo(task, 0, actions[task])) for task in TASKS]
    data = ExpertData(pairs, TASKS, PRESETS["LoRes4E"], remove_noops=True)
    batch = sample_windows(config(batch_size=64), data, np.random.default_rng(3))
    lengths = set()
    for row, task in enumerate(batch.tasks.tolist()):
        shown = [int(image[-1, 0, 0] * 255) // 14 for image in batch.images[row]]
        kept = [action for action in actions[TASKS[task]] if action]
        until = kept[: kept.index(shown[-1]) + 1][-WINDOW:]
        missing = WINDOW - len(until)
        assert batch.exist[row].tolist() == [step >= missing for step in range(WINDOW)]
        assert shown[missing:] == until  # the brightness tells the action
        assert batch.actions[row].tolist()[missing:] == until
        earlier = [NOOP, *kept][kept.index(until[0]) :][: len(until)]
        assert batch.before[row].tolist()[missing:] == earlier
        lengths.add(len(until))
    assert lengths == {1, 2, 3, 4}


def test_the_actions_before_are_those_that_were_executed() -> None:
    trajectory = replace(
        picture_demo("MoveToCorner", 0, [3, 9, 5]), expert_actions=np.array([3, 4, 5])
    )
    data = ExpertData([("MoveToCorner", trajectory)], TASKS[:1], PRESETS["LoRes4E"])
    batch = sample_windows(config(tasks=TASKS[:1], batch_size=16), data, np.random.default_rng(0))
    (last,) = np.flatnonzero(batch.actions[:, -1] == 5)[:1]
    assert batch.actions[last, -3:].tolist() == [3, 4, 5]
    assert batch.before[last, -3:].tolist() == [NOOP, 3, 9]
    assert batch.exist[last, -3:].all()


def test_a_window_is_augmented_in_one_way() -> None:
    pairs = [(task, picture_demo(task, 0, [3, 4])) for task in TASKS]
    data = ExpertData(pairs, TASKS, PRESETS["LoRes4E"])
    fields = {"augment": "translation", "batch_size": 4}
    images = sample_windows(config(**fields), data, np.random.default_rng(0)).images
    first = images[:, :1].expand(-1, WINDOW - 2, *images.shape[2:])
    assert torch.equal(images[:, 1 : WINDOW - 1], first)  # repeated before the start
    assert not torch.equal(images[0, 0], images[1, 0])


@pytest.mark.parametrize("training", [False, True])
def test_steps_see_earlier_ones_that_exist_and_no_others(
    training: bool, inputs: tuple[Tensor, Tensor, Tensor]
) -> None:
    """In training mode, too, whose attention is computed by other code."""
    tokens, before, exist = inputs
    network = make_policy(config()).train(training)
    for module in network.modules():
        if isinstance(module, torch.nn.Dropout):
            module.p = 0.0
        if isinstance(module, torch.nn.MultiheadAttention):
            module.dropout = 0.0
    plain = logits(network, tokens, before, exist)
    for step in range(WINDOW):
        changed = tokens.clone()
        changed[:, step] *= -1.0
        moved = (logits(network, changed, before, exist) - plain).abs().amax(dim=2) > 1e-5
        assert moved[0].tolist() == [later >= step for later in range(WINDOW)]
        assert moved[1, 2:].tolist() == [exist[1, step].item() and k >= step for k in (2, 3)]
    assert torch.isfinite(plain).all()


def test_both_modes_compute_the_same(inputs: tuple[Tensor, Tensor, Tensor]) -> None:
    network = make_policy(config()).eval()
    fast = logits(network, *inputs)
    torch.backends.mha.set_fastpath_enabled(False)
    try:
        torch.testing.assert_close(logits(network, *inputs)[inputs[2]], fast[inputs[2]])
    finally:
        torch.backends.mha.set_fastpath_enabled(True)


def test_windows_have_the_logits_of_their_own_tasks(inputs: tuple[Tensor, Tensor, Tensor]) -> None:
    network = make_policy(config()).eval()
    first, second, both = (logits(network, *inputs, tasks) for tasks in ((0, 0), (1, 1), (0, 1)))
    torch.testing.assert_close(both, torch.stack([first[0], second[1]]))
    assert not torch.allclose(first, second)


@pytest.mark.parametrize("seen", [False, True])
def test_past_actions_are_seen_where_they_are_asked_for(
    seen: bool, inputs: tuple[Tensor, Tensor, Tensor]
) -> None:
    tokens, before, exist = inputs
    network = make_policy(config(past_actions=seen)).eval()
    same = torch.equal(
        logits(network, tokens, before, exist), logits(network, tokens, before * 0, exist)
    )
    assert same != seen


def frames_of(count: int, rows: int) -> NDArray[np.uint8]:
    return np.random.default_rng(0).integers(0, 256, (count, rows, 96, 96, 12), np.uint8)


@pytest.mark.parametrize("past_actions", [False, True])
def test_a_policy_computes_what_training_does_on_the_same_window(past_actions: bool) -> None:
    made = config(past_actions=past_actions)
    network = make_policy(made)
    policy = MemoryPolicy(network, made, CPU, greedy=True)
    assert not network.training
    frames, actions = frames_of(7, 1), [NOOP]
    policy.reset(np.ones(1, np.bool_))
    for step in range(len(frames)):
        (action,) = policy.act(frames[step], [ID], np.random.default_rng(0)).tolist()
        steps = range(max(0, step + 1 - WINDOW), step + 1)
        padding = WINDOW - len(steps)
        images = to_unit(torch.from_numpy(frames[list(steps), 0]).permute(0, 3, 1, 2))
        with torch.no_grad():
            tokens = network(images, torch.zeros(len(steps), dtype=torch.int64))
        tokens = torch.cat([torch.zeros(padding, WIDTH), tokens])[None]
        before = torch.tensor([[NOOP] * padding + [actions[k] for k in steps]])
        exist = torch.tensor([[False] * padding + [True] * len(steps)])
        assert logits(network, tokens, before, exist)[0, -1].argmax() == action
        actions.append(action)
    assert len(set(actions)) > 1


def test_episodes_may_start_at_any_time() -> None:
    frames, made = frames_of(6, 2), config()
    network = make_policy(made)

    def probabilities(rows: list[int], first: int, start: tuple[int, int] | None) -> list[Any]:
        policy, found = MemoryPolicy(network, made, CPU, greedy=True), []
        policy.reset(np.ones(len(rows), np.bool_))
        for step in range(first, len(frames)):
            if start and step == start[0]:
                policy.reset(np.arange(len(rows)) == start[1])
            policy.act(frames[step, rows], [ID] * len(rows), np.random.default_rng(0))
            window = (policy._tokens, policy._before, policy._exist)
            found.append(logits(network, *window)[:, -1])
        return found

    together = probabilities([0, 1], 0, start=(3, 1))
    for row, first in ((0, 0), (1, 3)):
        alone = probabilities([row], first, None)
        for both, one in zip(together[first:], alone, strict=True):
            torch.testing.assert_close(both[row], one[0])


def test_a_batch_is_overfitted() -> None:
    generator = np.random.default_rng(0)
    pairs = [(task, picture_demo(task, 0, generator.integers(1, 18, 6))) for task in TASKS]
    data = ExpertData(pairs, TASKS, PRESETS["LoRes4E"], remove_noops=True)
    network = make_policy(config())
    batch = sample_windows(config(batch_size=3), data, np.random.default_rng(0))
    optimizer = torch.optim.AdamW(network.parameters(), 1e-3)
    first: dict[str, Tensor] = {}
    for _ in range(25):
        found = memory_losses(network, batch)
        first = first or found
        optimizer.zero_grad()
        torch.autograd.backward(found["loss"])
        optimizer.step()
    assert found["loss"] < 0.3 * first["loss"]
    assert found["accuracy"] == 1.0
