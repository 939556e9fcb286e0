"""Demonstrations of continuous actions: stored, converted, recorded, generated, exported."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from conftest import SHARED
from magical.demos import Dataset, DatasetWriter, RecordTrajectories, Trajectory, observations
from magical.demos.generate import demonstrate
from magical.demos.replay import replay
from magical.demos.store.codec import decode, encode
from magical.demos.store.summary import summarise_dataset
from magical.envs.env import MagicalEnv
from magical.errors import DatasetError, TrajectoryError
from magical.scene import to_continuous
from magical.scene.actions import POINTS
from tests.demos.conftest import MakeTrajectory, Run

COLUMNS = "actions", "expert_actions", "policy_actions"
HUMAN = SHARED / "human-poses"


@pytest.fixture
def recorded(tmp_path: Path) -> Trajectory:
    """An episode of continuous actions, recorded by the wrapper."""
    inner = MagicalEnv(
        "MoveToCorner", "TestJitter", observation="state", horizon=6, action_space="continuous"
    )
    env = RecordTrajectories(inner, tmp_path / "recorded", demonstrator="random")
    env.reset(seed=4)
    rng = np.random.default_rng(0)
    for _ in range(6):
        env.step(rng.uniform(-1.0, 1.0, 3).astype(np.float32))
    return Dataset.open(tmp_path / "recorded")[0]


def test_a_recorded_episode_replays_exactly(recorded: Trajectory) -> None:
    assert recorded.action_space == "continuous"
    assert recorded.actions.shape == (6, 3)
    assert recorded.actions.dtype == np.float64
    assert replay(recorded).departure == 0.0
    assert observations(recorded, "state").shape[0] == 7  # simulated again
    assert decode(encode(recorded)).actions.tolist() == recorded.actions.tolist()
    with pytest.raises(TrajectoryError, match="18 discrete actions"):
        recorded.with_action_space("discrete")


def test_conversion_keeps_everything_else(make_trajectory: MakeTrajectory) -> None:
    more = {name: np.arange(12) for name in COLUMNS[1:]}
    plain = make_trajectory(**more, actors=np.ones(12, np.uint8))
    points = decode(encode(plain.with_action_space("continuous")))
    assert plain.with_action_space("discrete") is plain
    assert replay(points).departure == 0.0
    for name in COLUMNS:
        np.testing.assert_array_equal(getattr(points, name), to_continuous(getattr(plain, name)))
    assert encode(points.with_action_space("discrete")) == encode(plain)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("actions", np.full((12, 3), 1.5), "actions: .* found drive 1.5 in row 0"),
        ("actions", np.zeros((12, 2)), "actions: .* of shape"),
        ("actions", np.zeros((0, 3)), "actions"),
        ("expert_actions", np.zeros((12, 3)), "expert_actions: expected 12 integers"),
    ],
)
def test_other_actions_are_refused(
    make_trajectory: MakeTrajectory, name: str, value: Any, message: str
) -> None:
    with pytest.raises(TrajectoryError, match=message):
        replace(make_trajectory(), **{name: value})


def test_a_file_with_two_kinds_of_actions_is_refused(
    make_trajectory: MakeTrajectory, monkeypatch: pytest.MonkeyPatch
) -> None:
    mixed = make_trajectory(expert_actions=np.zeros(12, np.int64)).with_action_space("continuous")
    object.__setattr__(mixed, "expert_actions", np.zeros(12, np.int64))
    with pytest.raises(DatasetError, match="expert_actions"):
        decode(encode(mixed))


def test_datasets_of_both_kinds_are_summarised_and_read(
    make_trajectory: MakeTrajectory, recorded: Trajectory, tmp_path: Path
) -> None:
    discrete = make_trajectory(env_id=str(recorded.env_id))
    writer = DatasetWriter(tmp_path / "both")
    for trajectory in (discrete, recorded):
        writer.append(trajectory)
    dataset = Dataset.open(tmp_path / "both")
    assert dataset.action_space() == "continuous"
    (summary,) = summarise_dataset(dataset)
    assert summary.action_spaces == ("continuous", "discrete")
    assert sum(summary.actions) == 12
    assert sum(share for _, share in summary.action_frequencies) == pytest.approx(12 / 18)
    arrays = dataset.arrays("state")
    assert arrays["actions"].shape == arrays["labels"].shape == (18, 3)
    np.testing.assert_array_equal(arrays["actions"][:12], to_continuous(discrete.actions))


def test_experts_demonstrate_the_same_with_points(tmp_path: Path, run: Run) -> None:
    out, env_id = tmp_path / "points", "magical/MoveToCorner-Demo-v0"
    arguments = ["--env", env_id, "-n", "1", "--out", str(out), "--workers", "1"]
    code, _ = run("generate", *arguments, "--action-space", "continuous")
    assert code == 0
    (made,) = Dataset.open(out)
    expected = demonstrate(env_id, made.seed or 0)
    assert made.poses is not None
    np.testing.assert_array_equal(made.poses, expected.poses)
    np.testing.assert_array_equal(made.with_action_space("discrete").actions, expected.actions)


def test_exports_have_the_action_space_that_is_asked_for(
    make_trajectory: MakeTrajectory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("av")
    parquet = pytest.importorskip("pyarrow.parquet")
    minari = pytest.importorskip("minari")
    from magical.demos.export.lerobot import export_lerobot
    from magical.demos.export.minari import export_minari

    trajectory = make_trajectory(steps=4, expert_actions=np.arange(4))
    DatasetWriter(tmp_path / "demos").append(trajectory)
    dataset = Dataset.open(tmp_path / "demos")
    export_lerobot(dataset, tmp_path / "lerobot", "continuous")
    info = json.loads((tmp_path / "lerobot/meta/info.json").read_text())
    feature = {"dtype": "float32", "shape": [3], "names": ["drive", "turn", "grip"]}
    assert info["features"]["action"] == feature
    rows = parquet.read_table(tmp_path / "lerobot/data").to_pylist()
    assert [row["action"] for row in rows] == to_continuous(range(4)).tolist()

    (name,) = export_minari(dataset, root=tmp_path / "minari", action_space="continuous")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))
    loaded = minari.load_dataset(name)
    (episode,) = loaded
    np.testing.assert_array_equal(episode.actions, to_continuous(trajectory.actions))
    np.testing.assert_array_equal(episode.infos["expert_action"][:-1], to_continuous(range(4)))
    assert loaded.action_space == loaded.spec.env_spec.make().action_space


@pytest.mark.skipif(not HUMAN.exists(), reason="the human demonstrations are not here")
def test_human_demonstrations_convert_exactly() -> None:
    dataset = Dataset.open(HUMAN)
    first = {entry.task: i for i, entry in reversed(list(enumerate(dataset.entries)))}
    for trajectory in (dataset[i] for i in first.values()):
        points = trajectory.with_action_space("continuous")
        assert encode(points.with_action_space("discrete")) == encode(trajectory)
        assert points.actions.tolist() == list(map(list, np.array(POINTS)[trajectory.actions]))
