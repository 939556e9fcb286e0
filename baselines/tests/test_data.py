"""Training data: demonstrations as stacks of frames, and replay buffers."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from baselines.tests.conftest import STEPS, TASKS, picture_demo, write_demos
from baselines.tests.tiny_runs import tiny
from magical.demos import Actor, observations
from magical.errors import DemonstrationsError
from magical.observe import PRESETS, PixelSpec
from magical.scene import View
from magical_baselines.algorithms.bc import BCConfig
from magical_baselines.config import IMAGE_OBSERVATIONS
from magical_baselines.data import (
    ExpertData,
    RecentRollouts,
    ReplayBuffer,
    expert_transitions,
    sample_demonstrations,
)


def pairs(trajectories, task):
    return [(task, t) for t in trajectories if t.task.name == task]


@pytest.mark.parametrize("preset", IMAGE_OBSERVATIONS)
def test_images_are_what_the_environment_showed(preset, trajectories):
    some = pairs(trajectories, "MoveToCorner")[:2]
    data = ExpertData(some, ["MoveToCorner"], PRESETS[preset])
    shown = np.concatenate([np.asarray(observations(t, preset))[:-1] for _, t in some])
    if not PRESETS[preset].channels_first:
        shown = shown.transpose(0, 3, 1, 2)
    assert len(data) == 2 * STEPS
    np.testing.assert_array_equal(data.images(np.arange(len(data))).numpy(), shown)
    np.testing.assert_array_equal(data.images(np.array([13, 2])).numpy(), shown[[13, 2]])
    labels, tasks = data.labels(np.array([13, 2]))
    assert labels.tolist() == [int(some[1][1].actions[1]), int(some[0][1].actions[2])]
    assert tasks.tolist() == [0, 0]


WATCHED = np.array([Actor.POLICY, Actor.HUMAN, Actor.HUMAN, 0])


@pytest.mark.parametrize(
    ("actions", "changes", "remove_noops", "labels", "steps"),
    [
        pytest.param([0, 5, 0, 0, 7], {}, True, [5, 7], [1, 4], id="without no-ops"),
        pytest.param(
            [3, 0, 4], {"expert_actions": np.array([0, 5, 7])}, True, [5, 7], [1, 2], id="labels"
        ),
        pytest.param(
            [3, 0, 4, 8], {"actors": WATCHED}, False, [0, 4], [1, 2], id="a watched policy"
        ),
        pytest.param([3, 0, 4, 8], {"actors": WATCHED}, True, [4], [2], id="watched, no no-ops"),
    ],
)
def test_which_steps_are_learned_and_with_which_labels(
    actions, changes, remove_noops, labels, steps
):
    """The frames before the steps that are left out stay in the stacks."""
    task, spec = "MoveToCorner", PRESETS["LoRes4E"]
    trajectory = replace(picture_demo(task, 0, actions), **changes)
    data = ExpertData([(task, trajectory)], [task], spec, remove_noops=remove_noops)
    assert data.actions.tolist() == labels
    shown = np.asarray(observations(trajectory, "LoRes4E")).transpose(0, 3, 1, 2)
    np.testing.assert_array_equal(data.images(np.arange(len(data))).numpy(), shown[steps])


def test_neighbours_are_on_the_same_side_of_what_a_policy_did():
    actors = np.array([Actor.HUMAN] * 3 + [Actor.POLICY] * 2 + [Actor.HUMAN] * 3, np.uint8)
    trajectory = replace(
        picture_demo("MoveToCorner", 0, [3, 0, 4, 8, 8, 5, 6, 7]),
        actors=actors,
        policy_actions=np.full(8, 8),
    )
    demos = [("MoveToCorner", trajectory)]
    data = ExpertData(demos, ["MoveToCorner"], PRESETS["LoRes4E"], remove_noops=True)
    assert data.actions.tolist() == [3, 4, 5, 6, 7]
    found, exist = data.neighbours(np.arange(5), np.array([-1, 0, 1]))
    assert found.tolist() == [[0, 0, 1], [0, 1, 1], [2, 2, 3], [2, 3, 4], [3, 4, 4]]
    assert (found[~exist] == np.arange(5)[np.nonzero(~exist)[0]]).all()
    assert exist.sum(axis=1).tolist() == [2, 2, 2, 3, 2]


def test_what_follows_another_action_than_the_label_does_not_continue_it():
    """The fourth label is a no-op, and left out, but another action was executed there."""
    trajectory = replace(
        picture_demo("MoveToCorner", 0, [3, 9, 5, 8, 6, 7]),
        expert_actions=np.array([3, 4, 5, 0, 6, 7]),
    )
    demos = [("MoveToCorner", trajectory)]
    data = ExpertData(demos, ["MoveToCorner"], PRESETS["LoRes4E"], remove_noops=True)
    assert data.actions.tolist() == [3, 4, 5, 6, 7]
    assert data.executed.tolist() == [3, 9, 5, 6, 7]
    assert data.is_last.tolist() == [False] * 4 + [True]
    found, _ = data.neighbours(np.arange(5), np.array([-2, -1, 1, 2]))
    assert found.tolist() == [[0, 0, 1, 1], [0, 0, 1, 1], [0, 1, 2, 2], [1, 2, 4, 4], [2, 3, 4, 4]]


def test_nothing_but_noops_is_an_error():
    task, nothing = "MoveToCorner", picture_demo("MoveToCorner", 0, [0, 0, 0])
    with pytest.raises(DemonstrationsError, match="MoveToCorner: expected demonstrated actions"):
        ExpertData([(task, nothing)], [task], PRESETS["LoRes4E"], remove_noops=True)


def unequal_data():
    """Three samples of one task, thirty of the other."""
    return ExpertData(
        [
            ("MoveToCorner", picture_demo("MoveToCorner", 0, [1, 2, 3])),
            ("MoveToRegion", picture_demo("MoveToRegion", 0, [4] * 30)),
        ],
        TASKS,
        PRESETS["LoRes4E"],
    )


def test_tasks_have_equal_weight_whatever_their_lengths():
    data = unequal_data()
    rows = data.sample(6000, np.random.default_rng(0))
    sampled = data.labels(rows)[1].double().mean()
    assert abs(float(sampled) - 0.5) < 0.03
    assert set(rows.tolist()) == set(range(33))


def sampled(path, tasks, count=2, seed=0):
    config = tiny(BCConfig, demos=str(path), tasks=tasks, num_demos=count, seed=seed)
    return sample_demonstrations(config)


def test_the_seed_alone_chooses_and_every_task_as_if_alone(demos):
    def files(tasks, seed):
        return [r["file"] for r in sampled(demos, tasks, seed=seed)[1]]

    together = files(TASKS, 3)
    assert together == files(TASKS[:1], 3) + files(TASKS[1:], 3)
    assert len({tuple(files(TASKS[:1], seed)) for seed in range(12)}) > 3
    places = [[int(f[:6]) // 2 for f in files((task,), 3)] for task in TASKS]
    assert places[0] == places[1]


def test_too_few_and_other_tasks_are_named(demos):
    with pytest.raises(
        DemonstrationsError,
        match=r"at least 5 demonstrations of MoveToCorner \(Demo\), found 4.*MoveToRegion-Demo",
    ):
        sampled(demos, TASKS, 5)


def test_continuous_actions_are_learned_where_they_are_discrete_ones(trajectories, tmp_path):
    points = trajectories[0].with_action_space("continuous")
    ((_, learned),), _ = sampled(write_demos(tmp_path / "points", [points]), TASKS[:1], 1)
    assert learned.actions.tolist() == trajectories[0].actions.tolist()
    between = write_demos(
        tmp_path / "between", [replace(points, actions=np.full((len(points), 3), 0.5))]
    )
    with pytest.raises(DemonstrationsError, match="this learner takes discrete actions"):
        sampled(between, TASKS[:1], 1)


SPEC = PixelSpec(((View.EGO, 3), (View.ALLO, 1)), size=2)
NUM_ENVS, LENGTH = 3, 4  # steps of an episode

Step = tuple[bytes, int, bytes, bool, int]  # a transition as it can be compared


class PlainEnvs:
    """Frames that are all different, as whole stacks; an episode of `LENGTH` steps follows."""

    def __init__(self):
        self.rng = np.random.default_rng(0)
        self.stacks = [self._first() for _ in range(NUM_ENVS)]
        self.times = [0, 1, 2]
        self.tasks = np.array([0, 0, 1])

    def _frames(self):
        return self.rng.integers(0, 256, (2, 3, 2, 2), dtype=np.uint8)

    def _first(self):
        ego, allo = self._frames()
        return [ego, ego, ego], [allo]

    def observations(self):
        return torch.from_numpy(
            np.stack([np.concatenate([*ego, *allo]) for ego, allo in self.stacks])
        )

    def step(self):
        for row, (ego, _) in enumerate(self.stacks):
            new_ego, new_allo = self._frames()
            self.stacks[row] = ([*ego[1:], new_ego], [new_allo])
            self.times[row] += 1
        dones = np.array([time == LENGTH for time in self.times])
        final = self.observations()[torch.from_numpy(dones)] if dones.any() else None
        for row in np.flatnonzero(dones).tolist():
            self.stacks[row], self.times[row] = self._first(), 0
        return dones, final


def empty(capacity):
    frames = [torch.zeros((capacity, 3, 2, 2), dtype=torch.uint8) for _ in range(2)]
    return ReplayBuffer(SPEC, frames, capacity, num_tasks=2)


def filled(capacity, steps):
    """A buffer after so many steps of the environments, and all its transitions in order."""
    envs, buffer, seen = PlainEnvs(), empty(capacity), []
    buffer.start(envs.observations())
    for number in range(steps):
        seen += add_step(envs, buffer, number)
    return buffer, seen, envs


def add_step(envs, buffer, number):
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


def transitions(buffer, counts):
    found = buffer.sample(counts, np.random.default_rng(1))
    rows = zip(*(part.numpy() for part in found), strict=True)
    return [
        (before.tobytes(), action, after.tobytes(), end, task)
        for before, action, after, end, task in rows
    ]


def test_all_transitions_are_sampled_as_they_were():
    buffer, seen, _ = filled(capacity=1000, steps=11)
    found = transitions(buffer, [600, 300])
    assert [task for *_, task in found] == [0] * 600 + [1] * 300
    assert set(found) == set(seen)
    assert any(end for _, _, _, end, _ in seen)


def ego_frames(step):
    """The frames that a transition's window consists of."""
    whole = step[0][:36] + step[2][:36]
    return {whole[first : first + 12] for first in range(0, 72, 12)}


@pytest.mark.parametrize("capacity", [15, 20, 31])
def test_transitions_are_kept_as_long_as_all_their_frames_are(capacity):
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
        assert set(transitions(buffer, [400, 400])) == expected


def test_what_was_not_executed_is_left_out():
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


def rollouts(batches):
    """Rollouts of two steps of three environments, the last of another task; all values differ."""
    replay = RecentRollouts(np.array([0, 0, 1]), "cpu", capacity=2)
    for number in range(batches):
        observations = torch.arange(6).view(2, 3, 1) + 10 * number
        replay.add(observations.to(torch.uint8), observations.squeeze(2))
    return replay


@pytest.mark.parametrize(("batches", "kept"), [(1, {0}), (2, {0, 1}), (3, {1, 2})])
def test_novice_samples_come_from_the_last_batches(batches, kept):
    shown, actions, tasks = rollouts(batches).sample([200, 200], np.random.default_rng(0))
    assert torch.equal(shown.squeeze(1).long(), actions)
    assert set((actions // 10).tolist()) == kept
    assert set((actions % 10).tolist()) == set(range(6))
    assert torch.equal(tasks, (actions % 10 % 3 == 2).long())
    assert tasks.sum() == 200  # evenly, though only one environment in three has this task
