"""Chunks of demonstrated actions, and what a policy executes of predicted ones."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from baselines.tests.conftest import TASKS, picture_demo
from baselines.tests.tiny_runs import CPU
from magical.demos import Trajectory
from magical.observe import PRESETS
from magical.scene.actions import to_continuous
from magical_baselines.algorithms import act
from magical_baselines.algorithms.act import ACTConfig, ACTPolicy
from magical_baselines.algorithms.chunks import ChunkPolicy, sample_chunks
from magical_baselines.algorithms.diffusion import DiffusionConfig
from magical_baselines.data import ExpertData

LENGTH = 5


@pytest.mark.parametrize("space", ["discrete", "continuous"])
def test_a_chunk_has_the_next_actions_that_are_no_noops_up_to_the_end(space: Any) -> None:
    actions = {"MoveToCorner": [3, 0, 0, 4, 5, 9], "MoveToRegion": [7, 8, 0, 10, 11, 12, 13]}
    pairs: list[tuple[str, Trajectory]] = [
        (task, picture_demo(task, 0, actions[task]).with_action_space(space)) for task in TASKS
    ]
    data = ExpertData(pairs, TASKS, PRESETS["LoRes4E"], remove_noops=True)
    sizes = {"batch_size": 64, "chunk": LENGTH}
    config = ACTConfig.preset("quick", tasks=TASKS, demos="", augment="none", **sizes)
    batch = sample_chunks(config, data, np.random.default_rng(3))
    steps = set()
    for row, task in enumerate(batch.tasks.tolist()):
        shown = int(batch.images[row, -1, 0, 0] * 255) // 14  # the brightness tells the action
        kept = [action for action in actions[TASKS[task]] if action]
        after = kept[kept.index(shown) :][:LENGTH]
        padded = np.array(after + [kept[-1]] * (LENGTH - len(after)))
        expected = padded if space == "discrete" else to_continuous(padded)
        np.testing.assert_array_equal(batch.actions[row].numpy(), expected)
        assert batch.exist[row].tolist() == [step < len(after) for step in range(LENGTH)]
        steps.add(shown)
    assert steps == {3, 4, 5, 7, 8, 9, 10, 11, 12, 13}
    assert batch.actions.dtype == (torch.int64 if space == "discrete" else torch.float32)


def test_what_follows_another_action_than_the_label_is_unknown() -> None:
    trajectory = replace(
        picture_demo("MoveToCorner", 0, [3, 9, 5, 6]), expert_actions=np.array([3, 4, 5, 6])
    )
    data = ExpertData([("MoveToCorner", trajectory)], TASKS[:1], PRESETS["LoRes4E"])
    config = ACTConfig.preset("quick", tasks=TASKS[:1], demos="", batch_size=64, chunk=3)
    batch = sample_chunks(config, data, np.random.default_rng(0))
    found = {
        tuple(map(tuple, torch.stack(each, dim=1).tolist()))
        for each in zip(*batch[1:4], strict=True)
    }
    assert found == {  # pairs of an action, whether it exists, whether it is padding
        ((3, 1, 0), (4, 1, 0), (4, 0, 0)),
        ((4, 1, 0), (4, 0, 0), (4, 0, 0)),
        ((5, 1, 0), (6, 1, 0), (6, 0, 1)),
        ((6, 1, 0), (6, 0, 1), (6, 0, 1)),
    }


class Counting(nn.Module):
    """Chunks whose actions tell the frame's brightness, and their positions in the chunk."""

    def __init__(self, length: int) -> None:
        super().__init__()
        self.length, self.calls = length, 0

    def forward(self, images: Tensor, tasks: Tensor) -> Tensor:
        self.calls += 1
        frame = images[:, :1, 0, 0] * 255 / 100
        position = torch.arange(self.length) / 100
        return torch.stack([frame.expand(-1, self.length), position.expand(len(frame), -1),
                            frame + position + 0.9], dim=2)  # fmt: skip


def actions_of(policy: ChunkPolicy, frames: NDArray[Any], starts: Any = ()) -> NDArray[Any]:
    """The actions (T, B, 3) at the brightness of frames (T, B); `starts`: (step, row) of resets."""
    rng, found = np.random.default_rng(0), []
    count = frames.shape[1]
    policy.reset(np.ones(count, np.bool_))
    for step, values in enumerate(frames):
        if rows := [row for when, row in starts if when == step]:
            policy.reset(np.isin(np.arange(count), rows))
        observations = np.broadcast_to(values[:, None, None, None], (count, 96, 96, 12))
        ids = ["magical/MoveToCorner-Demo-v0"] * count
        found.append(policy.act(observations.astype(np.uint8), ids, rng))
    return np.array(found)


def make(kind: type[ChunkPolicy], **settings: Any) -> ChunkPolicy:
    config: Any = ACTConfig if kind is ACTPolicy else DiffusionConfig
    space = {"action_space": "continuous"} if kind is ACTPolicy else {}
    made = config.preset("quick", tasks=TASKS, demos="", chunk=LENGTH, **space, **settings)
    return kind(Counting(LENGTH), made, CPU)


@pytest.mark.parametrize("kind", [ChunkPolicy, ACTPolicy])
@pytest.mark.parametrize("execute", [1, 3, LENGTH])
def test_a_new_chunk_replaces_the_rest_of_the_one_before(
    execute: int, kind: type[ChunkPolicy]
) -> None:
    policy = make(kind, execute=execute)
    found = actions_of(policy, np.arange(12)[:, None])
    predicted_at = np.arange(12) // execute * execute
    np.testing.assert_allclose(found[:, 0, 0], predicted_at / 100, atol=1e-6)
    np.testing.assert_allclose(found[:, 0, 1], (np.arange(12) - predicted_at) / 100, atol=1e-6)
    assert policy.network.calls == -(-12 // execute)


@pytest.mark.parametrize("execute", [1, 2])
def test_temporal_ensembling_is_the_published_weighted_mean(
    execute: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Zhao et al., algorithm 2: w_i = exp(-m i), w_0 of the oldest prediction."""
    decay, frames = 0.3, np.random.default_rng(1).integers(100, size=(12, 2))
    monkeypatch.setattr(act, "ENSEMBLE_DECAY", decay)
    policy = make(ACTPolicy, ensemble=True, execute=execute)
    found = actions_of(policy, frames)
    for step in range(12):
        made = [t for t in range(0, step + 1, execute) if step - t < LENGTH]  # oldest first
        weights = np.exp(-decay * np.arange(len(made)))
        for row in range(2):
            means = weights @ (frames[made, row] / 100) / weights.sum()
            np.testing.assert_allclose(found[step, row, 0], means, atol=1e-6)
    assert found.max() == 1.0  # clipped


@pytest.mark.parametrize("ensemble", [False, True])
def test_episodes_may_start_at_any_time(ensemble: bool) -> None:
    frames = np.random.default_rng(2).integers(100, size=(12, 2))
    settings = {"execute": 3, "ensemble": ensemble}
    together = actions_of(make(ACTPolicy, **settings), frames, starts=[(4, 1)])
    first = actions_of(make(ACTPolicy, **settings), frames[:, :1])
    second = actions_of(make(ACTPolicy, **settings), frames[4:, 1:])
    np.testing.assert_array_equal(together[:, 0], first[:, 0])
    np.testing.assert_array_equal(together[4:, 1], second[:, 0])


class Logits(nn.Module):
    """The logits of action 4 or 7 in all steps, by the frame's brightness."""

    def forward(self, images: Tensor, tasks: Tensor) -> Tensor:
        probabilities = torch.full((len(images), LENGTH, 18), 1e-30)
        dark = images[:, 0, 0, 0] == 0
        probabilities[dark, :, 4] = 1.0
        probabilities[~dark, :, 7] = 1.0
        return probabilities.log()


@pytest.mark.parametrize("greedy", [False, True])
def test_probabilities_of_discrete_actions_are_averaged(greedy: bool) -> None:
    """One chunk of four is for action 4; by the mean of logits it would never be chosen."""
    config = ACTConfig.preset("quick", tasks=TASKS, demos="", chunk=LENGTH, ensemble=True)
    policy = ACTPolicy(Logits(), config, CPU, greedy)
    frames = np.zeros((4, 2000), np.uint8)
    frames[1:] = 100
    last = actions_of(policy, frames)[-1]
    assert last.dtype == np.int64
    if greedy:
        assert (last == 7).all()
    else:
        assert set(last.tolist()) == {4, 7}
        assert abs((last == 4).mean() - 0.25) < 0.03


def test_continuous_noops_of_labels_are_left_out() -> None:
    task = "MoveToCorner"
    discrete = picture_demo(task, 0, [3, 0, 4])
    perturbed = replace(discrete, expert_actions=np.array([0, 5, 6]))
    for trajectory, labels in ((discrete, [3, 4]), (perturbed, [5, 6])):
        continuous = trajectory.with_action_space("continuous")
        data = ExpertData([(task, continuous)], [task], PRESETS["LoRes4E"], remove_noops=True)
        np.testing.assert_array_equal(data.actions.numpy(), to_continuous(labels))
