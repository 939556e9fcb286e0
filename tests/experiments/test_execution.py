"""Execution of a plan: what is done once, what again, what is refused, what is recorded."""

import errno
import json
import os
import shutil
import signal
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import nn

import magical
from magical.cli import main
from magical.errors import DatasetError, PlacementError, ResultsError
from magical.evaluation import Evaluation, environments, read_entry
from magical.experiments import execution, forecast, one_run, results
from magical.experiments.execution import LocalExecutor, Resources, execute
from magical.experiments.one_run import evaluate_reference
from magical.experiments.results import Results
from magical.experiments.status import read_status
from magical.files import owned
from magical.learning import load_policy, read_config
from magical.learning.algorithms import bc
from magical.learning.running import training
from magical.plugins import import_user_module
from magical.runs import versions
from magical.runs.machine import machine
from magical.runs.plan import read_listing
from magical.tasks import unregister_task
from tests.experiments.conftest import Planned, Started
from tests.experiments.processes import scores_of


def results_of(out: Path) -> dict[str, dict[str, Any]]:
    """The final record of each run, by its folder's name."""
    return {
        path.parent.name: json.loads(path.read_text()) for path in out.glob("runs/*/result.json")
    }


@pytest.fixture
def copied(finished: Path, out: Path) -> Path:
    """Results of the tiny plan, to change."""
    return Path(shutil.copytree(finished, out))


def test_every_run_is_a_run_folder_with_an_entry_and_a_record(
    planned: Planned, finished: Path
) -> None:
    records = results_of(finished)
    for run in planned():
        folder = finished / "runs" / run.folder
        entry = read_entry(folder)
        assert entry.method == "BC tiny"
        assert [str(row.env_id) for row in entry.scores] == ["magical/MoveToRegion-Demo-v0"]
        assert entry.record.demonstrations == "2 of each task (expert)"
        assert entry.record.learned_from == ("demonstrations",)
        assert entry.record.policy == "."
        assert entry.evaluated.nudge == 1e-9
        assert entry.record.machine == machine()
        assert entry.record.versions == versions()
        assert read_config(folder).seed == run.seed
        assert load_policy(folder).tasks == ("MoveToRegion",)
        record = records[run.folder]
        assert (record["state"], record["identity"]) == ("done", run.identity)
        assert record["versions"]["magical"] == magical.__version__
        assert {"torch", "numpy", "python"} <= set(record["versions"])
        assert set(record["machine"]) == {"name", "platform", "processor", "cores"}
        assert set(record["seconds"]) == {"training", "evaluation"}
    seconds = [sum(records[run.folder]["seconds"].values()) for run in planned()]
    assert [run.seconds for run in read_status(finished).runs] == seconds


def test_what_is_done_is_not_done_again_and_a_changed_plan_runs_what_changed(
    planned: Planned, inline: Started, copied: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    summary = execute(planned(), copied)
    assert (summary.complete, summary.total, summary.interrupted) == (True, 2, False)
    assert inline == []
    execute(planned(("seeds = [0, 1]", "seeds = [1, 2]")), copied)
    assert [run.seed for run in inline] == [2]
    assert "an earlier plan or other demonstrations: 1\n" in capsys.readouterr().err
    status = read_status(str(copied))
    assert (status.counts["done"], status.others, status.active) == (2, 1, False)
    inline.clear()
    execute(planned(("seeds = [0, 1]", "seeds = [0]"), ("batches = 6", "batches = 7")), copied)
    assert [run.config.num_updates for run in inline] == [7]
    for record in copied.glob("runs/*/result.json"):
        record.write_text('{"state": "done", "seconds": {"training": "long"}}')
    assert read_status(copied).counts["done"] == 1


def test_a_failing_run_is_recorded_and_does_not_stop_the_others(
    planned: Planned,
    inline: Started,
    out: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    runs = planned()

    def train(config: Any, *args: Any, **kwargs: Any) -> Any:
        if config.seed == 0:
            raise PlacementError("no room")
        return training.train(config, *args, **kwargs)

    monkeypatch.setattr("magical.experiments.one_run.train", train)
    summary = execute(runs, out)
    assert (summary.counts["done"], summary.counts["failed"]) == (1, 1)
    assert "failed: BC tiny, MoveToRegion, seed 0" in capsys.readouterr().err
    record = results_of(out)[runs[0].folder]
    assert record["error"] == "no room"
    assert "in train" in record["traceback"]
    (failed,) = (run for run in read_status(out).runs if run.state == "failed")
    assert failed.error == "no room"

    monkeypatch.setattr("magical.experiments.one_run.train", training.train)
    inline.clear()
    assert not execute(runs, out).complete
    assert inline == []
    assert execute(runs, out, retry_failed=True).complete
    assert [run.seed for run in inline] == [0]


@pytest.mark.posix
def test_an_interrupted_run_resumes_from_its_checkpoint(
    planned: Planned,
    inline: Started,
    out: Path,
    finished: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    (run, _) = runs = planned()
    steps: list[int] = []

    def train(config: Any, folder: Path, **kwargs: Any) -> Any:
        def interrupt(step: int, metrics: object) -> None:
            steps.append(step)
            if len(steps) == 3:
                os.kill(os.getpid(), signal.SIGTERM)

        return training.train(config, folder, callback=interrupt, **kwargs)

    monkeypatch.setattr("magical.experiments.one_run.train", train)
    execute([run], out)
    assert steps == [1, 2, 3, 4]  # a signal is seen after the next batch
    assert results_of(out) == {}
    assert [one.step for one in read_status(out).runs] == [4]
    assert execute([run], out).complete
    assert steps == [1, 2, 3, 4, 5, 6]
    assert execute(runs, out).complete
    assert scores_of(out) == scores_of(finished)


def test_a_run_with_a_damaged_checkpoint_fails_and_keeps_it(
    planned: Planned, inline: Started, copied: Path
) -> None:
    (run, _) = planned()
    folder = copied / "runs" / run.folder
    (folder / "result.json").unlink()
    (folder / "checkpoint.safetensors").write_bytes(b"damaged")
    assert execute([run], copied).counts["failed"] == 1
    assert "checkpoint.safetensors is damaged" in results_of(copied)[run.folder]["error"]
    assert (folder / "checkpoint.safetensors").read_bytes() == b"damaged"


def test_checkpoints_of_another_network_are_left_as_they_are(
    planned: Planned, inline: Started, copied: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (run, _) = planned()
    folder = copied / "runs" / run.folder
    (folder / "result.json").unlink()
    before = (folder / "checkpoint.safetensors").read_bytes()
    made = bc.make_policy
    monkeypatch.setattr(bc, "make_policy", lambda config: nn.Sequential(made(config)))
    assert execute([run], copied).counts["failed"] == 1
    assert "the checkpoint is of another network" in results_of(copied)[run.folder]["error"]
    assert (folder / "checkpoint.safetensors").read_bytes() == before


def test_what_a_killed_process_left_does_not_stand_in_the_way(
    planned: Planned, inline: Started, out: Path
) -> None:
    (run, _) = planned()
    folder = out / "runs" / run.folder
    with results.opened(out, [run]) as opened:
        opened.write_plan([run])
        opened.write_progress([run], 2)
        assert read_status(out).counts["running"] == 1
    with results.opened(out, [run]):
        assert read_status(out).counts["running"] == 0
    folder.mkdir(parents=True)
    assert execute([run], out).complete


def test_no_space_stops_the_plan_and_says_so(
    planned: Planned, inline: Started, out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*args: object, **kwargs: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    runs = planned()
    for part in ("evaluate_run", "finish"):  # in a run, or where its process does something else
        inline.clear()
        monkeypatch.setattr(one_run, part, full)
        with pytest.raises(ResultsError, match=r"no space left on the device.* free some space"):
            execute(runs, out)
        assert [run.seed for run in inline] == [0]
        assert results_of(out) == {}
    monkeypatch.setattr(results, "write_json", full)
    with pytest.raises(ResultsError, match="no space left on the device"):
        execute(runs, out)


def test_other_folders_are_refused(planned: Planned, inline: Started, copied: Path) -> None:
    runs, out = planned(), copied
    with pytest.raises(ResultsError, match="expected a new or an empty folder"):
        execute(runs, out / "demos")
    with pytest.raises(ResultsError, match="results of another plan, with the methods BC tiny;"):
        execute(planned(('"BC tiny"', '"BC"')), out)
    experiment = json.loads((out / "experiment.json").read_text())
    other = {**experiment, "versions": {"magical": "0.0.1"}, "more": 1}
    (out / "experiment.json").write_text(json.dumps(other))
    with pytest.raises(ResultsError, match=r"results of magical 0\.0\.1 .*this is magical"):
        execute(runs, out)
    for damaged in ("{", json.dumps({**experiment, "demonstrations": [1]})):
        (out / "experiment.json").write_text(damaged)
        with pytest.raises(ResultsError, match=r"experiment\.json"):
            execute(runs, out)


def test_a_plan_that_is_refused_leaves_the_one_before_listed(
    planned: Planned, inline: Started, copied: Path, tmp_path: Path
) -> None:
    with pytest.raises(DatasetError, match="no-such-folder"):
        execute(planned(demos=str(tmp_path / "no-such-folder")), copied)
    assert read_status(copied).counts["done"] == 2


def test_a_folder_is_used_by_one_execution_at_a_time(
    planned: Planned, inline: Started, copied: Path
) -> None:
    with owned(copied, ResultsError, "runs a plan"):
        assert read_status(copied).active
        with pytest.raises(ResultsError, match="another process already runs a plan"):
            execute(planned(), copied)
    (copied / "runs" / planned()[0].folder / "result.json").write_text("{")
    status = read_status(str(copied))
    assert not status.active
    assert [run.state for run in status.runs] == ["failed", "done"]
    assert "result.json" in status.runs[0].error


def test_status_and_dry_run_on_the_command_line(
    tiny: Path,
    inline: Started,
    out: Path,
    finished: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def result(*argv: str) -> tuple[list[str], dict[str, Any]]:
        assert main([*argv, "--json"]) == 0
        lines = capsys.readouterr().out.splitlines()
        return lines, json.loads(lines[-1])

    dry = ("run", str(tiny), "--out", str(out), "--dry-run")
    lines, plan = result(*dry)
    assert not out.exists()
    assert plan["runs"] == 2
    assert [(one["method"], one["tasks"], one["seed"]) for one in plan["plan"]] == [
        ("BC tiny", ["MoveToRegion"], 0),
        ("BC tiny", ["MoveToRegion"], 1),
    ]
    assert all(one["seconds"] > 0 for one in plan["plan"])
    assert "measured just now on this machine" in lines[-2]
    assert main(["status", str(out)]) == 1
    assert "expected a results folder" in capsys.readouterr().err

    shutil.copytree(finished, out)
    _, summary = result("run", str(tiny), "--out", str(out))
    assert (summary["runs"], summary["done"], summary["failed"]) == (2, 2, 0)
    assert [one["state"] for one in result(*dry)[1]["plan"]] == ["done", "done"]
    _, status = result("status", str(out))
    assert (status["done"], status["waiting"], status["active"]) == (2, 0, False)


def test_failed_runs_are_left_only_where_they_are_tried_again(
    planned: Planned, copied: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(forecast, "estimate", lambda runs: [60.0] * 2)
    record = copied / "runs" / planned()[0].folder / "result.json"
    record.write_text(record.read_text().replace('"done"', '"failed"'))
    for again, left in ((False, "0:00:00"), (True, "0:01:00")):
        found = forecast.forecast(planned(), copied, retry_failed=again)
        assert list(found.lines())[1].startswith(f"time left, one run at a time: {left}")


def test_runs_take_turns_on_the_visible_gpus(
    planned: Planned, out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[tuple[Any, ...]] = []
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    monkeypatch.setattr(execution, "ProcessPool", lambda *args: made.append(args))
    runs, results = planned(("seeds = [0, 1]", "seeds = [0, 1, 2]")), Results(out, "")
    for visible, gpus in ((None, ["0", "1"]), ("7,3", ["7", "3"])):
        monkeypatch.delenv("CUDA_VISIBLE_DEVICES", raising=False)
        if visible:
            monkeypatch.setenv("CUDA_VISIBLE_DEVICES", visible)
        LocalExecutor(runs, results, 4)
        assert made.pop() == (3, [{"CUDA_VISIBLE_DEVICES": gpu} for gpu in gpus])
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 0)
    LocalExecutor(runs, results, 2)
    assert made.pop() == (2, [{}])


@pytest.mark.parametrize(("workers", "slots"), [(None, 2), (5, 5)])
def test_the_cores_have_room_for_the_threads_of_all_runs(
    planned: Planned, finished: Path, monkeypatch: pytest.MonkeyPatch, workers: int, slots: int
) -> None:
    monkeypatch.setattr("magical.experiments.execution.available_cores", lambda: 8)
    runs = planned(("seeds = [0, 1]", "seeds = [0, 1]\nthreads = 3"))
    with closing(LocalExecutor(runs, Results(finished, ""), workers)) as executor:
        assert executor.slots() == slots


def test_a_reference_is_evaluated_again_where_the_evaluation_is_another(tmp_path: Path) -> None:
    folder = tmp_path / "references" / "noop-MoveToRegion"
    for variant, rollouts, horizon in (
        ("Demo", 1, 1),
        ("Demo", 2, 1),
        ("Demo", 2, 3),
        ("TestAll", 2, 3),
    ):
        env_ids = environments(["MoveToRegion"], [variant])
        evaluation = Evaluation.of(env_ids, rollouts=rollouts, horizon=horizon)
        evaluate_reference(("noop", evaluation), tmp_path)
        entry, before = read_entry(folder), (folder / "scores.csv").stat().st_mtime_ns
        assert [row.env_id for row in entry.scores] == env_ids * rollouts
        assert entry.evaluated.horizon_name == str(horizon)
        evaluate_reference(("noop", evaluation), tmp_path)
        assert (folder / "scores.csv").stat().st_mtime_ns == before


OUTSIDE = """
from dataclasses import replace
from magical.experts import register_planner
from magical.experts.goals import get_planner
from magical.tasks import get_task
TASK = replace(get_task("MoveToRegion"), name="DriveHere", section="")
register_planner("DriveHere", get_planner("MoveToRegion"))
"""


def test_a_task_of_a_module_is_known_in_the_processes_of_runs_and_references(
    planned: Planned, out: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "task_for_a_plan.py").write_text(OUTSIDE)
    monkeypatch.syspath_prepend(tmp_path)
    import_user_module("task_for_a_plan")
    changes = ('["MoveToRegion"]', '["task_for_a_plan:TASK"]'), ("seeds = [0, 1]", "seeds = [0]")
    try:
        runs = planned(*changes)
        references = [("expert", runs[0].evaluation)]
        assert execute(runs, out, Resources(workers=1), references=references).complete
        assert (out / "references" / "expert-DriveHere" / "scores.csv").exists()
        assert read_listing(out).references == ("expert-DriveHere",)
    finally:
        unregister_task("DriveHere")
