"""The demonstrations of an experiment: a dataset's, generated ones, or both."""

import json
import os
import shutil
import signal
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from magical.demos import Dataset, DatasetWriter
from magical.demos.generate import generate
from magical.envs.seeds import episode_seed
from magical.errors import DatasetError, DemonstrationsError, ResultsError
from magical.evaluation import read_entry
from magical.experiments.demonstrations import generate_missing
from magical.experiments.execution import execute
from tests.experiments.conftest import Planned, Started


def test_demonstrations_of_a_dataset(
    planned: Planned, inline: Started, out: Path, finished: Path, tmp_path: Path
) -> None:
    with pytest.raises(DatasetError, match="human"):
        execute(planned(demos=str(tmp_path / "human")), out)
    demos = Path(shutil.copytree(finished / "demos" / "expert-3", tmp_path / "human"))
    runs = planned(demos=str(demos))
    with pytest.raises(DemonstrationsError, match="at least 4 demonstrations of MoveToRegion"):
        execute(planned(("num_demos = 2", "num_demos = 4"), demos=str(demos)), tmp_path / "few")
    execute(runs[:1], out)
    assert read_entry(out / "runs" / runs[0].folder).record.demonstrations.endswith("(dataset)")
    generate("magical/MoveToCorner-Demo-v0", 1, demos, workers=1)
    assert execute(runs[:1], out).complete  # another task's are not what it learned from
    DatasetWriter(demos).append(Dataset.open(demos)[0])
    for some in (runs, runs[:1]):  # one waits; all are done
        with pytest.raises(ResultsError, match="learned from other demonstrations of MoveToRegion"):
            execute(some, out)
    shutil.rmtree(demos)
    assert execute(runs[:1], out).complete


def test_generated_demonstrations_are_not_replaced(
    planned: Planned, inline: Started, out: Path
) -> None:
    runs = planned()
    execute(runs[:1], out)
    shutil.rmtree(out / "demos")
    shutil.copytree(out, out.with_name("again"))
    execute(runs, out)  # they are generated again, and are the same
    other = out.with_name("again") / "demos/expert-3"
    generate_missing(other, ["MoveToRegion"], 3, perturb=0.5, workers=1)
    with pytest.raises(ResultsError, match="learned from other demonstrations of MoveToRegion"):
        execute(runs, out.with_name("again"))
    shutil.rmtree(other)
    generate("magical/MoveToRegion-Demo-v0", 3, other, seed=9)
    with pytest.raises(DatasetError, match="expected demonstrations generated with seed 0"):
        execute(runs, out.with_name("again"))


@pytest.mark.posix
def test_a_signal_ends_the_generation_of_demonstrations(
    planned: Planned, inline: Started, out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def signal_then_generate(*args: Any, **kwargs: Any) -> None:
        os.kill(os.getpid(), signal.SIGTERM)
        generate_missing(*args, **kwargs)

    monkeypatch.setattr("magical.experiments.demonstrations.generate_missing", signal_then_generate)
    summary = execute(planned(), out)
    assert (summary.interrupted, inline) == (True, [])
    assert len(Dataset.open(out / "demos" / "expert-3")) == 1
    monkeypatch.undo()


def test_the_series_of_demonstrations_goes_on_after_many_that_were_dropped(tmp_path: Path) -> None:
    generate("magical/MoveToRegion-Demo-v0", 1, tmp_path / "demos", first=40)
    generate_missing(tmp_path / "demos", ["MoveToRegion"], 3, workers=1)
    seeds = [one.seed for one in Dataset.open(tmp_path / "demos").entries]
    assert seeds == [episode_seed(0, number) for number in (40, 41, 42)]


def test_perturbed_experts(planned: Planned, inline: Started, out: Path) -> None:
    (run, _) = runs = planned(
        ("expert_demos = 3", "expert_demos = 3\nperturb = 0.5\nmin_score = 0.5")
    )
    execute(runs[:1], out)
    demos = Dataset.open(out / "demos" / "expert-3-perturb-0.5-min-score-0.5")
    assert [one.expert_actions is not None for one in demos] == [True] * 3
    assert json.loads((out / "runs" / run.folder / "config.json").read_text())["demos"] == str(
        demos.path
    )
    assert read_entry(out / "runs" / run.folder).record.demonstrations == (
        "2 of each task (expert, perturb 0.5, min_score 0.5)"
    )


def test_the_experts_demonstrations_are_added_to_a_dataset(
    planned: Planned, inline: Started, out: Path, finished: Path, tmp_path: Path
) -> None:
    theirs = Dataset.open(finished / "demos" / "expert-3")
    writer = DatasetWriter(tmp_path / "human")
    for one in (theirs[2], theirs[1]):
        writer.append(replace(one, demonstrator="human"))
    add = ("num_demos = 2", "num_demos = 5\nadd_expert = true")
    runs = planned(add, demos=str(tmp_path / "human"))
    execute(runs[:1], out)
    pooled = Dataset.open(out / "demos" / "dataset-and-expert-3")
    assert [e.demonstrator for e in pooled.entries] == ["human"] * 2 + ["expert"] * 3
    expected = [theirs[i].actions.tolist() for i in (2, 1, 0, 1, 2)]
    assert [one.actions.tolist() for one in pooled] == expected
    record = read_entry(out / "runs" / runs[0].folder).record
    assert record.demonstrations == "5 of each task (dataset and expert)"
    whole = list(pooled)
    shutil.rmtree(pooled.path)
    DatasetWriter(pooled.path).append(whole[0])
    execute(runs, out)  # copying goes on where it was interrupted
    assert [e.sha256 for e in Dataset.open(pooled.path).entries] == [
        e.sha256 for e in pooled.entries
    ]

    more = ("num_demos = 2", "num_demos = 6\nadd_expert = true")
    with pytest.raises(DemonstrationsError, match="at least 6 demonstrations of MoveToRegion"):
        execute(planned(more, demos=str(tmp_path / "human")), tmp_path / "few")
    elsewhere = planned(add, ('"MoveToRegion"', '"MoveToCorner"'), demos=str(tmp_path / "human"))
    with pytest.raises(DemonstrationsError, match="at least 1 demonstrations of MoveToCorner"):
        execute(elsewhere, tmp_path / "none")


@pytest.mark.parametrize(("perturb", "min_score"), [(0.0, 0.0), (0.7, 0.9)])
def test_interrupted_generation_gives_the_same_demonstrations(
    tmp_path: Path, perturb: float, min_score: float
) -> None:
    generate = partial(generate_missing, perturb=perturb, min_score=min_score, workers=1)
    for counts in ((3,), (1, 3)):
        for count in counts:
            generate(tmp_path / str(counts), ["MoveToRegion"], count)
    whole, parts = (Dataset.open(tmp_path / str(counts)) for counts in ((3,), (1, 3)))
    assert [one.actions.tolist() for one in whole] == [one.actions.tolist() for one in parts]
    assert all(one.final_score >= min_score for one in whole.entries)
    attempts = [episode_seed(0, k) for k in range(3)]
    assert ([one.seed for one in whole] == attempts) == (min_score == 0.0)
