"""`magical train` from the command line."""

import json
import re
import shlex
import sys
from importlib.util import find_spec
from unittest.mock import MagicMock

import numpy as np
import pytest

from baselines.tests.conftest import write_demos
from magical.cli import main
from magical.demos import Trajectory
from magical.envs import EnvId
from magical.evaluation import read_entry
from magical.scene import Poses
from magical.tasks import get_task, unregister_task
from magical.tasks.registry import import_tasks

TINY = ["--preset", "quick", "--batches", "4", "--batch-size", "4", "--num-demos", "2"]


def bc(demos, out, *more):
    given = ["--task", "MoveToCorner", "--demos", str(demos), "--out", str(out)]
    return ["train", "bc", *given, *TINY, *more]


def test_train_stop_resume(demos, tmp_path, monkeypatch, capsys):
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


def test_the_next_command_imports_a_task_that_the_package_lacks(tmp_path, capsys, monkeypatch):
    (tmp_path / "task_to_train.py").write_text(
        "from dataclasses import replace\n"
        "from magical.tasks import get_task\n"
        "TASK = replace(get_task('MoveToCorner'), name='MoveThere', section='')\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    import_tasks("task_to_train")
    task = get_task("MoveThere")
    try:
        env_id, actions = EnvId("MoveThere", "Demo"), np.ones(5, np.int64)
        poses = np.stack([Poses.at_rest(task.demo).bodies] * 6)
        shown = Trajectory.from_bodies(env_id, task.demo, actions, poses, demonstrator="random")
        demos = write_demos(tmp_path / "demos", [shown, shown])
        given = ["--task", "MoveThere", "--demos", str(demos), "--out", str(tmp_path / "run")]
        assert main(["train", "bc", *given, *TINY]) == 0
        advice = capsys.readouterr().err.splitlines()[-1].partition("to evaluate: ")[2]
        assert advice == f"magical evaluate {tmp_path / 'run'} --import task_to_train"
    finally:
        unregister_task("MoveThere")


def test_an_evaluated_run_says_what_it_is_and_can_be_verified(demos, tmp_path, capsys):
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


def test_errors_say_what_to_do_and_have_status_1(demos, tmp_path, capsys):
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
def test_a_run_that_could_not_begin_leaves_no_folder(algorithm, existed, demos, tmp_path):
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
def test_wrong_arguments_have_status_2(wrong, demos, tmp_path):
    assert main(bc(demos, tmp_path / "run", *wrong)) == 2
    assert not (tmp_path / "run").exists()


def test_help_lists_algorithms_and_settings(capsys):
    assert main(["train", "--help"]) == 0
    assert "bc" in capsys.readouterr().out
    assert main(["train", "bc", "--help"]) == 0
    shown = capsys.readouterr().out
    for flag in ("--task", "--demos", "--preset", "--learning-rate", "--no-anneal", "--resume"):
        assert flag in shown
    for values in ("{light,narrow,paper}", "{auto,cpu,cuda}", "{sgd,adam}", "--batches N"):
        assert values in " ".join(shown.split())
    assert not re.search(r" (STR|INT|FLOAT)\b", shown)
