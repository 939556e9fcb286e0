"""DAgger from beginning to end, in the smallest runs."""

from pathlib import Path
from typing import Any

import pytest

from baselines.tests import tiny_runs
from baselines.tests.conftest import TASKS
from baselines.tests.tiny_runs import assert_same, checkpoint
from magical.demos import Dataset, DatasetWriter, Trajectory
from magical.errors import (
    DatasetError,
    NoExpertError,
    RunFolderError,
)
from magical.experts import goals
from magical.runs import read_metrics
from magical_baselines import train
from magical_baselines.algorithms.bc import BCConfig
from magical_baselines.algorithms.dagger import AGGREGATE, DAggerConfig
from magical_baselines.config import options


def tiny(demos: Path, **fields: Any) -> DAggerConfig:
    settings = {"rounds": 3, "batches": 2, "batch_size": 3, "network": "light", "log_every": 1}
    every: dict[str, Any] = {**settings, "demos": str(demos), "checkpoint_every": 1}
    return tiny_runs.tiny(DAggerConfig, **{**every, **fields})


def assert_same_run(first: Path, second: Path) -> None:
    """Equal weights, optimisers and episodes; files differ in the time of recording."""
    a, b = ({**checkpoint(folder), "aggregate": None} for folder in (first, second))
    assert_same(a, b)
    for left, right in zip(aggregate(first), aggregate(second), strict=True):
        assert left.actions.tolist() == right.actions.tolist()
        assert left.labels.tolist() == right.labels.tolist()


def aggregate(folder: Path) -> Dataset:
    return Dataset.open(folder / AGGREGATE)


@pytest.fixture(scope="module")
def whole(demos: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that was never stopped."""
    folder = tmp_path_factory.mktemp("dagger") / "run"
    assert train(tiny(demos), folder).finished
    return folder


def test_the_aggregate_is_a_dataset_like_others(whole: Path) -> None:
    dataset = aggregate(whole)
    assert {entry.env_id for entry in dataset.entries} == {"magical/MoveToRegion-Demo-v0"}
    assert [t.metadata["round"] for t in dataset] == [1, 2]
    assert [t.metadata["expert_share"] for t in dataset] == [0.5, 0.25]
    assert [len(trajectory) for trajectory in dataset] == [40, 40]
    first, second = dataset
    assert first.seed != second.seed


def test_reports_count_the_experts_labels(whole: Path) -> None:
    rows = read_metrics(whole)
    assert [row["step"] for row in rows] == [1, 2, 3, 4, 5, 6]
    assert [row["round"] for row in rows] == [0, 0, 1, 1, 2, 2]
    assert [row["expert_share"] for row in rows] == [1.0, 1.0, 0.5, 0.5, 0.25, 0.25]
    # 12 actions in each of two demonstrations, then 40 in each episode
    assert [row["labels"] for row in rows[::2]] == [24, 64, 104]
    assert all(row["samples"] < row["labels"] for row in rows)
    assert "score" not in rows[0]
    scores = [entry.final_score for entry in aggregate(whole).entries]
    assert [row["score"] for row in rows[2::2]] == pytest.approx(scores, abs=1e-6)


def test_resumed_runs_are_bit_equal(demos: Path, tmp_path: Path) -> None:
    more: dict[str, Any] = {"tasks": TASKS, "variants": ("Demo", "TestJitter"), "episodes": 2}
    config = tiny(demos, **more)
    assert train(config, tmp_path / "whole").finished
    parts = tmp_path / "parts"
    assert train(config, parts, stop_after=2).step == 2  # at a round's end
    assert train(config, parts, resume=True, stop_after=1).step == 3  # inside one
    assert train(config, parts, resume=True, stop_after=2).step == 5
    assert train(config, parts, resume=True).finished
    assert_same_run(tmp_path / "whole", parts)
    assert train(config, parts, resume=True).finished
    speed = "samples_per_second"
    first, second = (
        [{**row, speed: 0.0} for row in read_metrics(folder)]
        for folder in (tmp_path / "whole", parts)
    )
    assert first == second


def test_a_round_that_was_cut_short_while_stored_is_completed(
    demos: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = tiny(demos, episodes=2)
    append = DatasetWriter.append

    def full_after_three(self: Any, trajectory: Trajectory) -> Any:
        if len(aggregate(self.path.parent)) == 3:
            raise DatasetError("the disk is full")
        return append(self, trajectory)

    with monkeypatch.context() as patch:
        patch.setattr(DatasetWriter, "append", full_after_three)
        with pytest.raises(DatasetError):
            train(config, tmp_path / "run")
    assert len(aggregate(tmp_path / "run")) == 3
    assert train(config, tmp_path / "run", resume=True).finished
    train(config, tmp_path / "whole")
    assert_same_run(tmp_path / "run", tmp_path / "whole")


def test_another_aggregate_cannot_continue_a_run(demos: Path, tmp_path: Path, whole: Path) -> None:
    config = tiny(demos)
    train(config, tmp_path / "run", stop_after=3)
    (tmp_path / "run" / AGGREGATE).rename(tmp_path / "own")
    with pytest.raises(RunFolderError, match=r"expected the 1 episodes.*restore"):
        train(config, tmp_path / "run", resume=True)


def test_the_paper_preset_splits_the_batches_of_behavioural_cloning() -> None:
    paper, table = (
        kind.preset("paper", tasks=TASKS[:1], demos="") for kind in (DAggerConfig, BCConfig)
    )
    assert isinstance(paper, DAggerConfig)
    assert paper.num_updates == table.num_updates == 20_000
    names = [option.name for option in options(BCConfig) if option.name != "batches"]
    assert all(getattr(paper, name) == getattr(table, name) for name in names)
    assert [paper.beta(number) for number in range(3)] == [1.0, 0.5, 0.25]


def test_every_variant_of_every_task_has_its_turn(demos: Path) -> None:
    names = ("Demo", "TestJitter", "Layout", "Shape")
    config = tiny(demos, tasks=TASKS, variants=names, episodes=4)
    assert config.variants == ("Demo", "Jitter", "Layout", "Shape")
    found = [env_id.removeprefix("magical/") for env_id in config.env_ids]
    corner, region = found[:4], found[4:]
    assert set(corner) == {
        f"MoveToCorner-{name}-v0" for name in ("Demo", "TestJitter", "TestShape")
    }
    assert set(region) == {
        f"MoveToRegion-{name}-v0" for name in ("Demo", "TestJitter", "TestLayout")
    }


def test_a_task_without_an_expert_is_named(demos: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(goals, "_planners", {})
    with pytest.raises(NoExpertError, match="'MoveToRegion' has no scripted expert"):
        tiny(demos)
