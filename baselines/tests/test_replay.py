"""Transitions whose frames are stored once, against lists of whole observations."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from baselines.tests.conftest import TASKS, picture_demo
from magical.demos import Trajectory
from magical.errors import DemonstrationsError
from magical.observe import PixelSpec
from magical.scene import View
from magical_baselines.data import ExpertData
from magical_baselines.replay import RecentRollouts, ReplayBuffer, expert_transitions

SPEC = PixelSpec(((View.EGO, 3), (View.ALLO, 1)), size=2)
NUM_ENVS, LENGTH = 3, 4  # steps of an episode

Step = tuple[bytes, int, bytes, bool, int]  # a transition as it can be compared


class PlainEnvs:
    """Frames that are all different, as whole stacks; an episode of `LENGTH` steps follows."""

    def __init__(self) -> None:
        self.rng = np.random.default_rng(0)
        self.stacks = [self._first() for _ in range(NUM_ENVS)]
        self.times = [0, 1, 2]
        self.tasks = np.array([0, 0, 1])

    def _frames(self) -> Any:
        return self.rng.integers(0, 256, (2, 3, 2, 2), dtype=np.uint8)

    def _first(self) -> Any:
        ego, allo = self._frames()
        return [ego, ego, ego], [allo]

    def observations(self) -> torch.Tensor:
        return torch.from_numpy(
            np.stack([np.concatenate([*ego, *allo]) for ego, allo in self.stacks])
        )

    def step(self) -> tuple[Any, torch.Tensor | None]:
        for row, (ego, _) in enumerate(self.stacks):
            new_ego, new_allo = self._frames()
            self.stacks[row] = ([*ego[1:], new_ego], [new_allo])
            self.times[row] += 1
        dones = np.array([time == LENGTH for time in self.times])
        final = self.observations()[torch.from_numpy(dones)] if dones.any() else None
        for row in np.flatnonzero(dones).tolist():
            self.stacks[row], self.times[row] = self._first(), 0
        return dones, final


def empty(capacity: int) -> ReplayBuffer:
    frames = [torch.zeros((capacity, 3, 2, 2), dtype=torch.uint8) for _ in range(2)]
    return ReplayBuffer(SPEC, frames, capacity, num_tasks=2)


def filled(capacity: int, steps: int) -> tuple[ReplayBuffer, list[Step], PlainEnvs]:
    """A buffer after so many steps of the environments, and all its transitions in order."""
    envs, buffer, seen = PlainEnvs(), empty(capacity), []
    buffer.start(envs.observations())
    for number in range(steps):
        seen += add_step(envs, buffer, number)
    return buffer, seen, envs


def add_step(envs: PlainEnvs, buffer: ReplayBuffer, number: int) -> list[Step]:
    before = envs.observations()
    dones, final = envs.step()
    after = envs.observations()
    actions = torch.arange(NUM_ENVS) + number
    buffer.add(actions, dones, after, final, envs.tasks)
    if final is not None:
        after[torch.from_numpy(dones)] = final
    return [
        (before[n].numpy().tobytes(), n + number, after[n].numpy().tobytes(), dones[n], task)
        for n, task in enumerate(envs.tasks.tolist())
    ]


def sampled(buffer: ReplayBuffer, counts: list[int]) -> list[Step]:
    found = buffer.sample(counts, np.random.default_rng(1))
    rows = zip(*(part.numpy() for part in found), strict=True)
    return [
        (before.tobytes(), action, after.tobytes(), end, task)
        for before, action, after, end, task in rows
    ]


def test_all_transitions_are_sampled_as_they_were() -> None:
    buffer, seen, _ = filled(capacity=1000, steps=11)
    found = sampled(buffer, [600, 300])
    assert [task for *_, task in found] == [0] * 600 + [1] * 300
    assert set(found) == set(seen)
    assert any(end for _, _, _, end, _ in seen)


def ego_frames(step: Step) -> set[bytes]:
    """The frames that a transition's window consists of."""
    whole = step[0][:36] + step[2][:36]
    return {whole[first : first + 12] for first in range(0, 72, 12)}


@pytest.mark.parametrize("capacity", [15, 20, 31])
def test_transitions_are_kept_as_long_as_all_their_frames_are(capacity: int) -> None:
    envs, buffer, seen = PlainEnvs(), empty(capacity), []
    buffer.start(envs.observations())
    stored = [stack[0][-1].tobytes() for stack in envs.stacks]
    for number in range(25):
        new = add_step(envs, buffer, number)
        seen += new
        stored += [step[2][24:36] for step in new]
        stored += [envs.stacks[n][0][-1].tobytes() for n, step in enumerate(new) if step[3]]
        kept = set(stored[-capacity:])
        expected = {step for step in seen if ego_frames(step) <= kept}
        assert set(sampled(buffer, [400, 400])) == expected


def test_it_goes_on_as_it_was_saved() -> None:
    buffer, _, envs = filled(capacity=31, steps=9)
    again = empty(31)
    again.load_state_dict(buffer.state_dict())
    assert sampled(again, [50, 50]) == sampled(buffer, [50, 50])
    before = envs.observations()
    dones, final = envs.step()
    for each in (buffer, again):
        each.add(torch.arange(NUM_ENVS), dones, envs.observations(), final, envs.tasks)
    assert sampled(again, [50, 50]) == sampled(buffer, [50, 50])
    assert before[0].numpy().tobytes() in {step[0] for step in sampled(again, [50, 50])}


def test_transitions_of_demonstrations(trajectories: list[Trajectory]) -> None:
    spec = PixelSpec(((View.ALLO, 2), (View.EGO, 1)))
    named = [(task, t) for task in TASKS for t in trajectories if task in t.env_id]
    data = ExpertData(named, TASKS, spec, transitions=True)
    found = expert_transitions(data, [200, 200], np.random.default_rng(0))
    every = {}
    for number, (_, t) in enumerate(named):
        assert t.frames is not None
        for step, action in enumerate(t.actions.tolist()):
            stacks = []
            for time in (step, step + 1):
                allo = [t.frames["allo"][max(time - 1, 0)], t.frames["allo"][time]]
                stack = np.concatenate([*allo, t.frames["ego"][time]], axis=2)
                stacks.append(stack.transpose(2, 0, 1).tobytes())
            is_last = step == len(t) - 1
            every[stacks[0]] = (action, stacks[1], is_last, TASKS.index(named[number][0]))
    keys = [images.numpy().tobytes() for images in found.observations]
    assert len(set(keys)) > 70  # of 96
    for row, key in enumerate(keys):
        after = found.next_observations[row].numpy().tobytes()
        action, last, task = (int(part[row]) for part in (found.actions, found.ends, found.tasks))
        assert (action, after, bool(last), task) == every[key]


def test_what_was_not_executed_is_left_out() -> None:
    plain = picture_demo("MoveToCorner", 0)
    labels = plain.actions.copy()
    labels[3] = (labels[3] + 1) % 18
    labelled = replace(plain, expert_actions=labels)
    spec = PixelSpec(((View.EGO, 1),))
    data = ExpertData([("MoveToCorner", labelled)], ["MoveToCorner"], spec, transitions=True)
    found = expert_transitions(data, [500], np.random.default_rng(0))
    assert plain.frames is not None
    left_out = plain.frames["ego"][3].transpose(2, 0, 1).tobytes()
    keys = {images.numpy().tobytes() for images in found.observations}
    assert left_out not in keys
    assert len(keys) == len(plain) - 1
    none = replace(plain, expert_actions=(plain.actions + 1) % 18)
    with pytest.raises(DemonstrationsError, match=r"those that were not executed\), found none"):
        ExpertData([("MoveToCorner", none)], ["MoveToCorner"], spec, transitions=True)


def rollouts(batches: int) -> RecentRollouts:
    """Rollouts of two steps of three environments, the last of another task; all values differ."""
    replay = RecentRollouts(np.array([0, 0, 1]), "cpu", capacity=2)
    for number in range(batches):
        observations = torch.arange(6).view(2, 3, 1) + 10 * number
        replay.add(observations.to(torch.uint8), observations.squeeze(2))
    return replay


@pytest.mark.parametrize(("batches", "kept"), [(1, {0}), (2, {0, 1}), (3, {1, 2})])
def test_novice_samples_come_from_the_last_batches(batches: int, kept: set[int]) -> None:
    shown, actions, tasks = rollouts(batches).sample([200, 200], np.random.default_rng(0))
    assert torch.equal(shown.squeeze(1).long(), actions)
    assert set((actions // 10).tolist()) == kept
    assert set((actions % 10).tolist()) == set(range(6))
    assert torch.equal(tasks, (actions % 10 % 3 == 2).long())
    assert tasks.sum() == 200  # evenly, though only one environment in three has this task


@pytest.mark.parametrize("dtype", [torch.uint8, torch.float32])
def test_the_buffer_is_restored_from_its_state(dtype: torch.dtype) -> None:
    replay, other = (RecentRollouts(np.array([0, 0, 1]), "cpu", capacity=2) for _ in range(2))
    more = torch.arange(6).reshape(2, 3, 1)
    replay.add(more.to(dtype), more.squeeze(2))
    other.load_state_dict(replay.state_dict())
    for each in (replay, other):
        each.add(more.to(dtype), more.squeeze(2))
    first, second = (r.sample([30, 20], np.random.default_rng(1)) for r in (replay, other))
    assert all(torch.equal(a, b) for a, b in zip(first, second, strict=True))


def test_flat_images_are_small_in_a_checkpoint() -> None:
    replay = RecentRollouts(np.array([0]), "cpu")
    replay.add(torch.zeros(8, 1, 96, 96, 12, dtype=torch.uint8), torch.zeros(8, 1).long())
    assert replay.state_dict()["observations"].numel() < 8 * 96 * 96 * 12 / 50
