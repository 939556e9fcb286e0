"""Execution of a plan: what is done once, what again, what is refused, what is recorded."""

import errno
import json
import os
import shutil
import signal
from pathlib import Path

import pytest
from filelock import FileLock

import magical
from baselines.tests.experiments.conftest import Inline, execute, scores_of
from magical.cli import main
from magical.errors import PlacementError, RunFolderError
from magical.evaluation import read_entry
from magical.runs import machine, versions
from magical_baselines import load_policy, read_config
from magical_baselines import run as training
from magical_baselines.experiments import execution, one_run
from magical_baselines.experiments.status import lock_of, read_status


def record_of(out, run):
    """The final record of a run."""
    return dict(json.loads((out / "runs" / run.folder / "result.json").read_text()))


def states(out):
    """The states of a plan's runs."""
    return [run.state for run in read_status(out).runs]


@pytest.fixture
def copied(finished, out):
    """Results of the tiny plan, to change."""
    return Path(shutil.copytree(finished, out))


def test_every_run_is_a_run_folder_with_an_entry_and_a_record(planned, finished):
    assert [run.folder for run in planned()] == [f"bc-tiny-MoveToRegion-seed{k}" for k in (0, 1)]
    for run in planned():
        folder = finished / "runs" / run.folder
        entry = read_entry(folder)
        assert entry.method == "BC tiny"
        assert [str(row.env_id) for row in entry.scores] == ["magical/MoveToRegion-Demo-v0"]
        assert entry.record.demonstrations == "2 of each task (expert)"
        assert entry.record.learned_from == ("demonstrations",)
        assert entry.record.policy == "."
        assert entry.evaluated.nudge == 1e-9
        assert read_config(folder).seed == run.seed
        assert load_policy(folder).tasks == ("MoveToRegion",)
        record = record_of(finished, run)
        assert (record["state"], record["settings"]) == ("done", run.settings())
        assert record["versions"] == versions()
        assert record["versions"]["magical"] == magical.__version__
        assert record["machine"] == machine()
        assert set(record["seconds"]) == {"training", "evaluation"}


def test_what_is_done_is_not_done_again(planned, copied):
    assert execute(planned(), copied) == []
    more = planned(("seeds = [0, 1]", "seeds = [2, 1]"), ('["MoveToRegion"]', '["MoveToCorner"]'))
    assert [run.seed for run in execute([*planned()[:1], *more[:1]], copied)] == [2]
    assert [run.tasks for run in read_status(copied).runs] == [("MoveToRegion",), ("MoveToCorner",)]


@pytest.mark.parametrize("done", [True, False])
def test_a_run_with_other_settings_is_not_replaced(planned, copied, done):
    (run, _) = planned()
    if not done:
        (copied / "runs" / run.folder / "result.json").unlink()
    with pytest.raises(RunFolderError, match=f"{run.folder} holds .*batches 6 there, 7 asked for"):
        execute(planned(("batches = 6", "batches = 7")), copied)
    if done:
        with pytest.raises(RunFolderError, match="other settings: evaluation"):
            execute(planned(("rollouts = 1", "rollouts = 2")), copied)
        with pytest.raises(RunFolderError, match="demonstrations 'expert' there, 'dataset'"):
            execute(planned(demos=str(copied / "demos" / "expert-3")), copied)


def test_a_run_that_fails_does_not_stop_the_others(planned, out, monkeypatch, capsys):
    def train(config, folder, **kwargs):
        if config.seed == 0:
            raise PlacementError("no room")
        return training.train(config, folder, **kwargs)

    runs = planned()
    monkeypatch.setattr(one_run, "train", train)
    execute(runs, out)
    assert states(out) == ["failed", "done"]
    assert "failed: BC tiny, MoveToRegion, seed 0: no room (1 of 2)" in capsys.readouterr().err
    assert "in train" in record_of(out, runs[0])["traceback"]
    status = read_status(out)
    assert status.runs[0].error == "no room"
    assert str(status).endswith(f"magical run PLAN --out {out} --retry-failed")

    monkeypatch.setattr(one_run, "train", training.train)
    assert execute(runs, out) == []
    assert execute(runs, out, retry_failed=True) == runs[:1]
    assert read_status(out).complete


@pytest.mark.posix
def test_an_interrupted_run_resumes_from_its_checkpoint(planned, out, finished, monkeypatch):
    runs, steps = planned(), list[int]()

    def train(config, folder, **kwargs):
        def interrupt(step, metrics):
            steps.append(step)
            if len(steps) == 3:
                assert states(out) == ["running"]
                os.kill(os.getpid(), signal.SIGTERM)

        return training.train(config, folder, callback=interrupt, **kwargs)

    monkeypatch.setattr(one_run, "train", train)
    execute(runs[:1], out)
    assert steps == [1, 2, 3, 4]  # a signal is seen after the next batch
    (status,) = read_status(out).runs
    assert (status.state, status.progress) == ("waiting", "4 of 6")
    execute(runs, out)
    assert steps[:6] == [1, 2, 3, 4, 5, 6]
    assert scores_of(out) == scores_of(finished)


def test_no_space_stops_the_plan_and_says_so(planned, out, monkeypatch):
    def full(*args):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(one_run, "evaluate_run", full)
    with pytest.raises(RunFolderError, match=r"no space left on the device.* free some space"):
        execute(planned(), out)
    assert states(out) == ["waiting", "waiting"]


def test_other_folders_and_folders_in_use_are_refused(planned, copied):
    with pytest.raises(RunFolderError, match="expected an empty folder"):
        execute(planned(), copied / "demos")
    with FileLock(copied / ".lock"):
        assert read_status(copied).active
        with pytest.raises(RunFolderError, match="another process already runs a plan in it"):
            execute(planned(), copied)
    with FileLock(lock_of(copied / "runs" / planned()[1].folder)):
        (copied / "runs" / planned()[0].folder / "result.json").write_text("{")
        (copied / "runs" / planned()[1].folder / "result.json").unlink()
        first, second = read_status(copied).runs
    assert not read_status(copied).active
    assert (first.state, second.state) == ("failed", "running")
    assert "result.json" in first.progress
    assert second.progress == "6 of 6"


def test_status_and_dry_run_on_the_command_line(tiny, out, finished, monkeypatch, capsys):
    def result(*argv):
        assert main([*argv, "--json"]) == 0
        lines = capsys.readouterr().out.splitlines()
        return lines, json.loads(lines[-1])

    monkeypatch.setattr(execution, "Processes", lambda runs, workers: Inline())
    lines, plan = result("run", str(tiny), "--out", str(out), "--dry-run")
    assert not out.exists()
    assert [one["state"] for one in plan["plan"]] == ["waiting", "waiting"]
    assert plan["seconds"] >= 0
    assert lines[-2].startswith(f"{out}: 2 of 2 runs to do; training takes about ")
    assert main(["status", str(out)]) == 1
    assert "expected a results folder" in capsys.readouterr().err

    shutil.copytree(finished, out)
    _, summary = result("run", str(tiny), "--out", str(out))
    assert (summary["runs"], summary["done"], summary["interrupted"]) == (2, 2, False)
    lines, plan = result("run", str(tiny), "--out", str(out), "--dry-run")
    assert lines[-2] == f"{out}: 0 of 2 runs to do"
    lines, status = result("status", str(out))
    assert (status["done"], status["waiting"], status["active"]) == (2, 0, False)
    assert lines[2].split() == ["BC", "tiny,", "MoveToRegion,", "seed", "0", "done"]
