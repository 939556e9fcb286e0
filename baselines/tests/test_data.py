"""Demonstrations chosen, kept as single frames, sampled as stacks."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from baselines.tests.conftest import STEPS, TASKS, picture_demo
from magical.demos import Actor, Dataset, DatasetWriter, Trajectory, observations
from magical.errors import DemonstrationsError
from magical.files import sha256_sum
from magical.observe import PRESETS
from magical_baselines.config import IMAGE_OBSERVATIONS
from magical_baselines.data import ExpertData, sample_demonstrations, split_evenly


def pairs(trajectories: list[Trajectory], task: str) -> list[tuple[str, Trajectory]]:
    return [(task, t) for t in trajectories if t.task.name == task]


@pytest.mark.parametrize("preset", IMAGE_OBSERVATIONS)
def test_images_are_what_the_environment_showed(
    preset: str, trajectories: list[Trajectory]
) -> None:
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
    actions: list[int],
    changes: dict[str, Any],
    remove_noops: bool,
    labels: list[int],
    steps: list[int],
) -> None:
    """The frames before the steps that are left out stay in the stacks."""
    task, spec = "MoveToCorner", PRESETS["LoRes4E"]
    trajectory = replace(picture_demo(task, 0, actions), **changes)
    data = ExpertData([(task, trajectory)], [task], spec, remove_noops=remove_noops)
    assert data.actions.tolist() == labels
    shown = np.asarray(observations(trajectory, "LoRes4E")).transpose(0, 3, 1, 2)
    np.testing.assert_array_equal(data.images(np.arange(len(data))).numpy(), shown[steps])


def test_neighbours_are_of_the_same_demonstration() -> None:
    data = unequal_data()  # rows 0 to 2, and 3 to 32
    found, exist = data.neighbours(np.array([1, 3, 31]), np.array([-2, 0, 1, 2]))
    assert found.tolist() == [[0, 1, 2, 2], [3, 3, 4, 5], [29, 31, 32, 32]]
    assert exist.tolist() == [
        [False, True, True, False],
        [False, True, True, True],
        [True, True, True, False],
    ]


def test_neighbours_are_on_the_same_side_of_what_a_policy_did() -> None:
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


def test_what_follows_another_action_than_the_label_does_not_continue_it() -> None:
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


def test_nothing_but_noops_is_an_error() -> None:
    task, nothing = "MoveToCorner", picture_demo("MoveToCorner", 0, [0, 0, 0])
    with pytest.raises(DemonstrationsError, match="MoveToCorner: expected demonstrated actions"):
        ExpertData([(task, nothing)], [task], PRESETS["LoRes4E"], remove_noops=True)


def unequal_data() -> ExpertData:
    """Three samples of one task, thirty of the other."""
    return ExpertData(
        [
            ("MoveToCorner", picture_demo("MoveToCorner", 0, [1, 2, 3])),
            ("MoveToRegion", picture_demo("MoveToRegion", 0, [4] * 30)),
        ],
        TASKS,
        PRESETS["LoRes4E"],
    )


def test_tasks_have_equal_weight_whatever_their_lengths() -> None:
    data = unequal_data()
    rows = data.sample(6000, np.random.default_rng(0))
    sampled = data.labels(rows)[1].double().mean()
    assert abs(float(sampled) - 0.5) < 0.03
    assert set(rows.tolist()) == set(range(33))


def test_as_many_samples_of_each_task_as_asked_for() -> None:
    data = unequal_data()
    tasks = data.labels(data.sample_counts([13, 12], np.random.default_rng(0)))[1]
    assert tasks.tolist() == [0] * 13 + [1] * 12


def test_an_even_split_is_even_in_expectation() -> None:
    rng = np.random.default_rng(0)
    counts = np.array([split_evenly(12, 8, rng) for _ in range(4000)])
    assert set(counts.ravel().tolist()) == {1, 2}
    assert (counts.sum(axis=1) == 12).all()
    assert np.abs(counts.mean(axis=0) - 1.5).max() < 0.03  # standard error 0.008
    assert split_evenly(12, 4, rng) == [3, 3, 3, 3]


def test_the_seed_alone_chooses_and_every_task_as_if_alone(demos: Path) -> None:
    def files(tasks: tuple[str, ...], seed: int, count: int = 2) -> list[str]:
        return [r["file"] for r in sample_demonstrations(str(demos), tasks, count, seed).record]

    together = files(TASKS, 3)
    assert together == files(TASKS[:1], 3) + files(TASKS[1:], 3)
    assert together == files(TASKS, 3)
    assert len({tuple(files(TASKS[:1], seed)) for seed in range(12)}) > 3
    places = [[int(f[:6]) // 2 for f in files((task,), 3)] for task in TASKS]
    assert places[0] == places[1]


def test_the_record_names_files_and_sums(demos: Path) -> None:
    record = sample_demonstrations(str(demos), TASKS, 4, 0).record
    dataset = Dataset.open(demos)
    entries = {entry.file: sha256_sum(dataset.path / entry.file) for entry in dataset.entries}
    assert {r["file"]: r["sha256"] for r in record} == entries


def test_too_few_and_other_tasks_are_named(demos: Path) -> None:
    with pytest.raises(
        DemonstrationsError,
        match=r"at least 5 demonstrations of MoveToCorner \(Demo\), found 4.*MoveToRegion-Demo",
    ):
        sample_demonstrations(str(demos), TASKS, 5, 0)
    with pytest.raises(DemonstrationsError, match=r"of FindDupe .*found 0"):
        sample_demonstrations(str(demos), ("FindDupe",), 1, 0)


def test_continuous_actions_are_learned_where_they_are_discrete_ones(
    trajectories: list[Trajectory], tmp_path: Path
) -> None:
    points = trajectories[0].with_action_space("continuous")
    DatasetWriter(tmp_path / "points").append(points)
    ((_, learned),) = sample_demonstrations(
        str(tmp_path / "points"), [points.task.name], 1, 0
    ).trajectories
    assert learned.actions.tolist() == trajectories[0].actions.tolist()
    between = replace(points, actions=np.full((len(points), 3), 0.5))
    DatasetWriter(tmp_path / "between").append(between)
    with pytest.raises(DemonstrationsError, match="this learner takes discrete actions"):
        sample_demonstrations(str(tmp_path / "between"), [points.task.name], 1, 0)
