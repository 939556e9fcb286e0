"""Exports to Minari, read again by it."""

from pathlib import Path

import numpy as np
import pytest

from magical.demos import Dataset, RecordTrajectories, observations
from magical.envs.env import MagicalEnv
from magical.errors import DatasetError, UnknownNameError
from magical.observe import PRESETS
from tests.demos.export.conftest import MISSING

minari = pytest.importorskip("minari", reason=MISSING)
from magical.demos.export.minari import export_minari  # noqa: E402


@pytest.mark.parametrize("preset", ["LoRes4E", "LoResStack", "LoResCHW4E"])
def test_minari_export_is_lossless(
    mixed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, preset: str
) -> None:
    dataset, root = Dataset.open(mixed), tmp_path / "minari"
    names = export_minari(dataset, name="mine", preset=preset, root=root)
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(root))
    assert sorted(minari.list_local_datasets()) == sorted(names)
    for name in names:
        task, variant, _ = name.split("/")[1].split("-")
        part = dataset.filter(task=task, variant=variant)
        loaded = minari.load_dataset(name)
        assert loaded.observation_space == PRESETS[preset].space
        assert loaded.action_space.n == 18
        assert len(loaded) == len(part)
        assert not loaded.storage.jpeg_encoding
        for episode, trajectory in zip(loaded, part, strict=True):
            expected = observations(trajectory, preset)
            if isinstance(expected, dict):
                for view in expected:
                    np.testing.assert_array_equal(episode.observations[view], expected[view])
            else:
                np.testing.assert_array_equal(episode.observations, expected)
            np.testing.assert_array_equal(episode.actions, trajectory.actions)
            assert episode.truncations.tolist() == [False] * (len(trajectory) - 1) + [True]
            assert not episode.terminations.any()
            assert episode.infos["published_code_score"][-1] == trajectory.published_code_score
        (first, *_) = loaded.storage.get_episode_metadata([0])
        assert first["demonstrator"] == part[0].demonstrator
    recovered = minari.load_dataset(names[0]).recover_environment()
    assert recovered.observation_space == PRESETS[preset].space


def test_labels_are_infos_beside_the_executed_actions(
    labelled: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (name,) = export_minari(labelled, root=tmp_path / "minari")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))
    loaded = minari.load_dataset(name)
    first, second = loaded
    assert "expert_action" not in first.infos
    assert first.infos["is_demonstrated"].tolist() == [False, True, False, False]
    assert second.infos["expert_action"].tolist() == [17, 0, 4, -1]
    assert second.actions.tolist() == labelled[1].actions.tolist()
    facts = loaded.storage.get_episode_metadata([0, 1])
    assert [(each["demonstrator"], each["seed"]) for each in facts] == [("me", 1), ("random", 2)]


def test_refused_minari_export_leaves_no_files(mixed: Path, tmp_path: Path) -> None:
    root = tmp_path / "minari"
    part = Dataset.open(mixed).filter(task="MoveToCorner")
    export_minari(part, root=root)
    before = sorted(root.rglob("*"))
    with pytest.raises(DatasetError, match="a dataset of that name exists"):
        export_minari(part, root=root)
    with pytest.raises(UnknownNameError, match="expected one of LoResStack"):
        export_minari(part, preset="raw", root=root)
    with pytest.raises(DatasetError, match="expected trajectories, found none"):
        export_minari(part.filter(task="MakeLine"), root=root)
    for name in ("", "a b", "../a"):
        with pytest.raises(DatasetError, match="name: expected letters"):
            export_minari(part, name=name, root=root)
    broken = mixed / part.entries[1].file
    broken.write_bytes(broken.read_bytes()[:-50])
    with pytest.raises(DatasetError, match=broken.name):
        export_minari(part, name="other", root=root)
    assert sorted(root.rglob("*")) == before


def test_failed_minari_export_leaves_none_of_its_datasets(mixed: Path, tmp_path: Path) -> None:
    dataset, root = Dataset.open(mixed), tmp_path / "minari"
    last = dataset.entries[-1]
    assert last.env_id != dataset.entries[0].env_id
    broken = mixed / last.file
    whole = broken.read_bytes()
    broken.write_bytes(whole[:-50])
    with pytest.raises(DatasetError, match=broken.name):
        export_minari(dataset, root=root)
    assert not list(root.iterdir())
    broken.write_bytes(whole)
    export_minari(dataset.filter(env_id=last.env_id), root=root)
    before = sorted(root.rglob("*"))
    with pytest.raises(DatasetError, match="a dataset of that name exists"):
        export_minari(dataset, root=root)
    assert sorted(root.rglob("*")) == before


def test_the_environment_has_the_horizon_of_the_episodes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    env = RecordTrajectories(
        MagicalEnv("MoveToRegion", "Demo", observation="state", horizon=3),
        tmp_path / "d",
        demonstrator="x",
    )
    env.reset(seed=0)
    for _ in range(3):
        env.step(0)
    (name,) = export_minari(Dataset.open(tmp_path / "d"), name="short", root=tmp_path / "minari")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))
    recovered = minari.load_dataset(name).recover_environment()
    recovered.reset(seed=0)
    assert [recovered.step(0)[3] for _ in range(3)] == [False, False, True]
