"""`magical train` from the command line."""

import json
import re
import shlex
import sys
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from unittest.mock import MagicMock

import numpy as np
import pytest

from magical.cli import main
from magical.demos import DatasetWriter, Trajectory
from magical.envs import EnvId
from magical.evaluation import read_entry
from magical.report.found import find_results
from magical.report.leaderboard import faults
from magical.scene import Poses
from magical.tasks import get_task, register_task, unregister_task
from magical.tasks.registry import import_tasks

TINY = ["--preset", "quick", "--batches", "4", "--batch-size", "4", "--num-demos", "2"]


def bc(demos: Path, out: Path, *more: str) -> list[str]:
    given = ["--task", "MoveToCorner", "--demos", str(demos), "--out", str(out)]
    return ["train", "bc", *given, *TINY, *more]


def test_train_stop_resume(
    demos: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setitem(sys.modules, "wandb", MagicMock())
    out, track = tmp_path / "run", ["--track", "wandb"]
    assert main(bc(demos, out, "--stop-after", "2", "--json", *track)) == 0
    captured = capsys.readouterr()
    summary = json.loads(captured.out.splitlines()[-1])
    assert (summary["step"], summary["finished"], summary["total"]) == (2, False, 4)
    assert {"loss", "accuracy", "samples_per_second", "run"} <= set(summary)
    assert f"magical train bc --out {out} --resume {shlex.join(track)}" in captured.err
    moved = demos.rename(demos.with_name("moved demos"))
    again = ["train", "bc", "--out", str(out), "--resume", "--demos", str(moved)]
    assert main([*again, "--stop-after", "1"]) == 0
    assert shlex.join(["magical", *again]) in capsys.readouterr().err
    moved.rename(demos)
    assert main(["train", "bc", "--out", str(out), "--resume"]) == 0
    assert "finished; to evaluate: magical evaluate" in capsys.readouterr().err
    assert main(["train", "dagger", "--out", str(out), "--resume"]) == 2
    assert "expected a run of dagger, found one of bc" in capsys.readouterr().err
    assert main(bc(demos, out, "--resume")) == 0


@pytest.mark.parametrize(
    ("module", "line"),
    [("task_to_train", "TASK = {}"), ("task_to_register", "register_task({})"), ("", "")],
    ids=["variable", "registered", "in no module"],
)
def test_the_next_command_imports_a_task_that_the_package_lacks(
    module: str,
    line: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    if module:
        made = line.format("replace(get_task('MoveToCorner'), name='MoveThere', section='')")
        (tmp_path / f"{module}.py").write_text(
            "from dataclasses import replace\n"
            f"from magical.tasks import get_task, register_task\n{made}\n"
        )
        monkeypatch.syspath_prepend(tmp_path)
        import_tasks(module)
    else:
        register_task(replace(get_task("MoveToCorner"), name="MoveThere", section=""))
    task = get_task("MoveThere")
    try:
        env_id, actions = EnvId("MoveThere", "Demo"), np.ones(5, np.int64)
        poses = np.stack([Poses.at_rest(task.demo).bodies] * 6)
        shown = Trajectory.from_bodies(env_id, task.demo, actions, poses, demonstrator="random")
        writer = DatasetWriter(tmp_path / "demos")
        writer.append(shown)
        writer.append(shown)
        given = ["--task", "MoveThere", "--demos", str(writer.path), "--out", str(tmp_path / "run")]
        assert main(["train", "bc", *given, *TINY]) == 0
        advice = capsys.readouterr().err.splitlines()[-1].partition("to evaluate: ")[2]
        imports = f" --import {module}" if module else ""
        assert advice == f"magical evaluate {tmp_path / 'run'}{imports}"
    finally:
        unregister_task("MoveThere")


def test_an_evaluated_run_says_what_it_is_and_can_be_verified(
    demos: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from torch import get_num_threads

    run, entry = tmp_path / "run", tmp_path / "evaluation" / "run"
    assert main(bc(demos, run)) == 0
    options = ["--variants", "Demo", "--rollouts", "3", "--horizon", "5", "--workers", "0"]
    assert main(["evaluate", str(run), *options, "--out", str(entry)]) == 0
    record = read_entry(entry).record
    assert (record.policy, record.algorithm) == ("../../run", "bc")
    assert record.learned_from == ("demonstrations",)
    assert record.versions
    assert record.threads == get_num_threads()
    again = ["evaluate", str(run), *options, "--out", str(entry), "--training-seed"]
    assert main([*again, "7"]) == 2
    assert f"--training-seed 7: {run} records 0; leave the option out" in capsys.readouterr().err
    assert main([*again, "0"]) == 0
    assert main(["verify", str(entry), "--workers", "0"]) == 0
    assert "confirmed: 3 of 3" in capsys.readouterr().out
    (tmp_path / "far" / "away").mkdir(parents=True)
    (tmp_path / "link").symlink_to(tmp_path / "far" / "away")
    linked = tmp_path / "link" / "run"
    assert main(["evaluate", str(run), *options, "--out", str(linked)]) == 0
    assert main(["verify", str(linked), "--workers", "0"]) == 0
    assert len(find_results([linked, run]).results) == 1


def test_an_unfinished_run_says_so_wherever_it_is_evaluated(
    demos: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = tmp_path / "run"
    options = ["--variants", "Demo", "--rollouts", "1", "--horizon", "5", "--workers", "0"]
    evaluate = ["evaluate", str(run), *options, "--out", str(run)]
    assert main(bc(demos, run, "--stop-after", "1")) == 0
    assert main([*evaluate, "--json"]) == 0
    captured = capsys.readouterr()
    expected = {"done": 1, "planned": 4}
    assert json.loads(captured.out.splitlines()[-1])["unfinished"] == expected
    assert f"warning: {run}: training is unfinished: 1 of 4 updates are done" in captured.err
    assert read_entry(run).record.updates == (1, 4)
    assert main(["report", str(run)]) == 0
    assert "run (unfinished: 1 of 4 updates)" in capsys.readouterr().out
    assert any("unfinished (1 of 4 updates)" in fault for fault in faults(read_entry(run)))
    assert main(["train", "bc", "--out", str(run), "--resume"]) == 0
    capsys.readouterr()
    assert main([*evaluate, "--json"]) == 0
    captured = capsys.readouterr()
    assert "unfinished" not in json.loads(captured.out.splitlines()[-1])
    assert "warning" not in captured.err
    assert not any("unfinished" in fault for fault in faults(read_entry(run)))


def test_errors_say_what_to_do_and_have_status_1(
    demos: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "run"
    assert main(bc(demos, out, "--stop-after", "1")) == 0
    for arguments, message in (
        (bc(demos, out), "add --resume"),
        (bc(demos, out, "--seed", "7", "--resume"), "another configuration: seed 0 there, 7"),
        (bc(tmp_path / "none", tmp_path / "a"), "none"),
        (bc(demos, tmp_path / "b", "--num-demos", "9"), "ask for fewer with --num-demos"),
        (["train", "bc", "--out", str(tmp_path / "c"), "--resume", "--task", "FindDupe",
          "--demos", str(demos)], "expected a run folder with config.json"),
    ):  # fmt: skip
        assert main(arguments) == 1
        error = capsys.readouterr().err
        assert "error: " in error
        assert message in error


@pytest.mark.parametrize("existed", [False, True])
@pytest.mark.parametrize("algorithm", ["bc", "gail"])
def test_a_run_that_could_not_begin_leaves_no_folder(
    algorithm: str, existed: bool, demos: Path, tmp_path: Path
) -> None:
    out = tmp_path / "run"
    if existed:
        out.mkdir()
    shared = ["train", algorithm, "--task", "MoveToCorner", "--out", str(out), "--preset", "quick"]
    if find_spec("tensorboard"):
        shared += ["--track", "tensorboard"]
    assert main([*shared, "--demos", str(tmp_path / "none")]) == 1
    assert main([*shared, "--demos", str(demos), "--num-demos", "9"]) == 1
    assert out.exists() == existed
    assert not existed or not list(out.iterdir())


@pytest.mark.parametrize(
    "wrong",
    [
        ["--task", "Fly"],
        ["--observation", "LoResStack"],
        ["--augment", "blur"],
        ["--batches", "-1"],
        ["--batches", "many"],
        ["--preset", "slow"],
    ],
)
def test_wrong_arguments_have_status_2(wrong: list[str], demos: Path, tmp_path: Path) -> None:
    assert main(bc(demos, tmp_path / "run", *wrong)) == 2
    assert not (tmp_path / "run").exists()


def test_a_wrong_setting_is_said_in_one_line(
    demos: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(bc(demos, tmp_path / "run", "--batches", "many")) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.endswith("'many'; see magical train bc --help")


def test_what_is_required_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["train", "bc", "--out", str(tmp_path / "run")]) == 2
    assert "expected --task, --demos, found none" in capsys.readouterr().err


def test_help_lists_algorithms_and_settings(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["train", "--help"]) == 0
    assert "bc" in capsys.readouterr().out
    assert main(["train", "bc", "--help"]) == 0
    shown = capsys.readouterr().out
    for flag in ("--task", "--demos", "--preset", "--learning-rate", "--no-anneal", "--resume"):
        assert flag in shown
    for values in ("{light,narrow,paper}", "{auto,cpu,cuda}", "{sgd,adam}", "--batches N"):
        assert values in " ".join(shown.split())
    assert not re.search(r" (STR|INT|FLOAT)\b", shown)


def test_the_run_folder_gets_a_picture_of_the_learning_curves(demos: Path, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib", reason="the report extra is not installed")
    assert main(bc(demos, tmp_path / "run")) == 0
    assert (tmp_path / "run" / "learning-curves.png").read_bytes().startswith(b"\x89PNG")


def test_an_option_that_is_given_twice_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tasks = ["--task", "MoveToRegion", "--task=MoveToCorner"]
    assert main(["train", "bc", *tasks, "--out", str(tmp_path / "run")]) == 2
    assert "--task: given more than once" in capsys.readouterr().err
