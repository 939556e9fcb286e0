"""The demonstrations of a plan: a dataset's, generated ones, or both."""

import os
import shutil
import signal
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest

from baselines.tests.experiments.conftest import Inline, execute
from magical.demos import Dataset, DatasetWriter
from magical.envs.seeds import episode_seed
from magical.errors import DatasetError, DemonstrationsError
from magical.evaluation import read_entry
from magical_baselines.experiments import execution
from magical_baselines.experiments.execution import prepare_demonstrations


def test_demonstrations_of_a_dataset(planned, out, finished, tmp_path):
    with pytest.raises(DatasetError, match="human"):
        execute(planned(demos=str(tmp_path / "human")), out)
    demos = Path(shutil.copytree(finished / "demos" / "expert-3", tmp_path / "human"))
    runs = planned(demos=str(demos))
    with pytest.raises(DemonstrationsError, match="at least 4 demonstrations of MoveToRegion"):
        execute(planned(("num_demos = 2", "num_demos = 4"), demos=str(demos)), tmp_path / "few")
    execute(runs[:1], out)
    assert read_entry(out / "runs" / runs[0].folder).record.demonstrations.endswith("(dataset)")
    assert not (out / "demos").exists()
    shutil.rmtree(demos)
    assert execute(runs[:1], out) == []  # is done


@pytest.mark.posix
def test_a_signal_ends_the_generation_of_demonstrations(planned, out, monkeypatch):
    def signal_then_generate(*args, **kwargs):
        os.kill(os.getpid(), signal.SIGTERM)
        prepare_demonstrations(*args, **kwargs)

    monkeypatch.setattr(execution, "prepare_demonstrations", signal_then_generate)
    inline = Inline()
    assert execution.execute(planned(), out, inline, workers=1)
    assert inline.started == []
    assert len(Dataset.open(out / "demos" / "expert-3")) == 1


def test_the_experts_demonstrations_are_added_to_a_dataset(planned, out, finished, tmp_path):
    theirs = Dataset.open(finished / "demos" / "expert-3")
    writer = DatasetWriter(tmp_path / "human")
    for one in (theirs[2], theirs[1]):
        writer.append(replace(one, demonstrator="human"))
    add = ("num_demos = 2", "num_demos = 5\nadd_expert = true")
    runs = planned(add, demos=str(tmp_path / "human"))
    prepare = partial(prepare_demonstrations, workers=1)
    pooled = Dataset.open(prepare(runs, out) or "")
    assert pooled.path == out / "demos" / "dataset-and-expert-3"
    assert [e.demonstrator for e in pooled.entries] == ["human"] * 2 + ["expert"] * 3
    expected = [theirs[i].actions.tolist() for i in (2, 1, 0, 1, 2)]
    assert [one.actions.tolist() for one in pooled] == expected
    whole = list(pooled)
    shutil.rmtree(pooled.path)
    DatasetWriter(pooled.path).append(whole[0])
    prepare(runs, out)  # copying goes on where it was interrupted
    assert [one.actions.tolist() for one in Dataset.open(pooled.path)] == expected

    more = ("num_demos = 2", "num_demos = 6\nadd_expert = true")
    with pytest.raises(DemonstrationsError, match="at least 6 demonstrations of MoveToRegion"):
        prepare(planned(more, demos=str(tmp_path / "human")), out)
    elsewhere = planned(add, ('"MoveToRegion"', '"MoveToCorner"'), demos=str(tmp_path / "human"))
    with pytest.raises(DemonstrationsError, match="at least 1 demonstrations of MoveToCorner"):
        prepare(elsewhere, tmp_path / "none")


@pytest.mark.parametrize("min_score", [0.0, 0.9])
def test_interrupted_generation_gives_the_same_demonstrations(planned, tmp_path, min_score):
    class Interrupted(Exception):
        pass

    def interrupt(_):
        raise Interrupted

    how = f"expert_demos = 3\nperturb = 0.7\nmin_score = {min_score}"
    runs = planned(("expert_demos = 3", how))
    with pytest.raises(Interrupted):
        prepare_demonstrations(runs, tmp_path / "parts", 1, interrupt)
    whole, parts = (
        Dataset.open(prepare_demonstrations(runs, tmp_path / name, 1) or "")
        for name in ("whole", "parts")
    )
    assert len(whole) == 3
    assert [one.actions.tolist() for one in whole] == [one.actions.tolist() for one in parts]
    attempts = [episode_seed(0, k) for k in range(3)]
    assert ([one.seed for one in whole] == attempts) == (min_score == 0.0)
