"""Plans: the files of the repository, the runs that follow, and what is refused."""

import json
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from magical import plugins
from magical.cli import main
from magical.errors import PlanError
from magical.evaluation import published_methods, published_tasks
from magical_baselines.experiments.plan import PlannedRun, find_plan, planned_runs, read_plan

HEAD = 'tasks = ["MoveToCorner"]\npreset = "quick"\n'
BC = '[[methods]]\nname = "A"\nalgorithm = "bc"\n'


def write(folder: Path, text: str) -> Path:
    path = folder / "plan.toml"
    path.write_text(text)
    return path


def runs_of(folder: Path, text: str, demos: str | None = None) -> list[PlannedRun]:
    return planned_runs(read_plan(write(folder, text), demos))


def test_the_papers_plan_is_the_appendix_grid() -> None:
    runs = planned_runs(read_plan(find_plan("paper")))
    assert len(runs) == 370
    assert {run.method for run in runs} == set(published_methods())
    counts = Counter(run.method for run in runs)
    assert {name for name, count in counts.items() if count == 5} == {"BC (MT)", "GAIL (MT)"}
    assert set(counts.values()) == {5, 40}
    assert {task for run in runs for task in run.tasks} == set(published_tasks())
    assert len({run.folder for run in runs}) == 370


@pytest.mark.parametrize(
    ("method", "settings"),
    [
        ("BC (ST)", {"observation": "LoRes4E", "augment": "all", "batches": 20_000}),
        ("BC (ST, allo.)", {"observation": "LoRes4A", "augment": "all"}),
        ("BC (ST, no aug.)", {"observation": "LoRes4E", "augment": "none"}),
        ("BC (ST, no trans./rot. aug.)", {"augment": "no-trans-rot"}),
        ("GAIL (ST, no aug.)", {"augment": "none", "total_steps": 1_000_000}),
        ("WGAIL-GP (ST)", {"algorithm": "wgail-gp", "penalty_weight": 100.0}),
    ],
)
def test_the_papers_rows_have_its_settings(method: str, settings: dict[str, Any]) -> None:
    runs = planned_runs(read_plan(find_plan("paper")))
    config = next(run.config.to_dict() for run in runs if run.method == method)
    assert settings.items() <= {**config}.items()
    assert config["num_demos"] == 10


def test_runs_are_methods_times_tasks_times_seeds(tmp_path: Path) -> None:
    text = 'tasks = ["MoveToCorner", "MoveToRegion"]\nseeds = [3, 5]\npreset = "quick"\n' + BC
    runs = runs_of(tmp_path, text + '[[methods]]\nname = "B"\nalgorithm = "bc"\nmulti_task = true')
    assert [str(run) for run in runs] == [
        "A, MoveToCorner, seed 3",
        "A, MoveToCorner, seed 5",
        "A, MoveToRegion, seed 3",
        "A, MoveToRegion, seed 5",
        "B, 2 tasks, seed 3",
        "B, 2 tasks, seed 5",
    ]


def test_the_settings_of_a_run_are_what_its_scores_depend_on(tmp_path: Path) -> None:
    def settings(text: str, demos: str | None = None) -> str:
        (run,) = runs_of(tmp_path, text + HEAD + BC, demos)
        return json.dumps(run.settings())

    assert settings("") == settings("# the same\n") == settings("", "expert")
    assert settings("", "human") == settings("", "elsewhere/human")
    changes = (
        "rollouts = 3\n",
        "seeds = [1]\n",
        "num_demos = 9\n",
        'variants = ["Demo"]\n',
        'horizon = "published"\n',
        "nudge = 1e-9\n",
        "threads = 2\n",
        'demos = "human"\n',
        "expert_demos = 26\n",
        "perturb = 0.2\n",
        "min_score = 0.5\n",
        'demos = "human"\nadd_expert = true\n',
        'demos = "human"\nadd_expert = true\nperturb = 0.2\n',
    )
    assert len({settings(text) for text in ("", *changes)}) == 14


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("tasks = [", "expected TOML"),
        ("", "expected the field methods"),
        ("methods = []", "methods: expected array of length >= 1"),
        ("sedes = [1]\n" + BC, "expected the fields methods, tasks, seeds,.*found 'sedes'"),
        (BC + 'settings = { augmnt = "none" }', r"methods\[0\]: settings.augmnt: unknown"),
        (BC + "settings = { seed = 1 }", r"methods\[0\]: settings.seed: unknown"),
        (BC + 'settings = { batches = "9" }', r"\(A\): batches: expected int, found str"),
        (BC + "settings = { batches = true }", r"\(A\): batches: expected int, found bool"),
        (BC + "settings = { batches = 0 }", r"methods\[0\] \(A\): batches: expected int >= 1"),
        (BC + "settings = { threads = 0 }", "threads: expected at least 1, found 0"),
        (BC.replace("bc", "bcc"), r"methods\[0\]: algorithm: algorithm 'bcc' is unknown"),
        (BC + 'preset = "slow"', r"methods\[0\] \(A\): preset 'slow' is unknown; bc has"),
        (BC.replace('"A"', "7"), r"methods\[0\].name: expected str, found int"),
        (BC.replace('"A"', '" "'), r"methods\[0\]: name: expected printable characters, found"),
        ('[[methods]]\nname = "A"', r"methods\[0\]: expected the field algorithm"),
        (BC + BC, "methods: name: expected each once, found 'A' twice"),
        (BC + BC.replace("A", "B"), "expected each run once, found the same settings twice"),
        (BC + BC.replace("A", "(a)"), r"the same folder twice: A, .*; \(a\), "),
        ('tasks = ["MoveToMoon"]\n' + BC, "tasks: .*MoveToMoon"),
        ('tasks = ["FindDupe", "FindDupe"]\n' + BC, "tasks: expected each once"),
        ("seeds = [0, 0]\n" + BC, "seeds: expected each once, found 0 twice"),
        ("seeds = [-1]\n" + BC, r"seeds\[0\]: expected int >= 0"),
        ("seeds = 5\n" + BC, "seeds: expected array, found int"),
        ("rollouts = 0\n" + BC, "rollouts: expected int >= 1"),
        ('variants = ["Weather"]\n' + BC, "variants: 'Weather' is not a variant"),
        ('variants = ["CountPlus"]\ntasks = ["MoveToCorner"]\n' + BC, "MoveToCorner has none of"),
        ("nudge = 1\n" + BC, "nudge: .*expected a number from 0 to"),
        (
            'horizon = "long"\n' + BC,
            "horizon: expected appendix, published or a number",
        ),
        ("perturb = 2\n" + BC, "perturb: expected a number from 0 to 1, found 2"),
        ('perturb = "much"\n' + BC, "perturb: expected float, found str"),
        ('demos = "human"\nperturb = 0.2\n' + BC, "perturb: expected 0 for a dataset, found 0.2"),
        ("min_score = 1.5\n" + BC, "min_score: expected float <= 1.0"),
        ('demos = "human"\nmin_score = 1\n' + BC, "min_score: expected 0 for a dataset, found 1"),
        ("add_expert = 1\n" + BC, "add_expert: expected bool, found int"),
        ("add_expert = true\n" + BC, "add_expert: expected demos, or --demos, to be a folder"),
        ("num_demos = 30\n" + BC, "expert_demos: expected at least num_demos, 30, found 25"),
        (
            BC.replace('"bc"', '"wgail-gp"\nmulti_task = true'),
            r"\(A\): wgail-gp: expected one task",
        ),
        (BC.replace('"bc"', '"al"\nmulti_task = true'), r"\(A\): al: expected one task"),
    ],
)
def test_a_wrong_plan_is_refused_with_file_and_key(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(PlanError, match=message) as refused:
        read_plan(write(tmp_path, text))
    assert str(refused.value).startswith(f"{tmp_path / 'plan.toml'}: ")


@pytest.mark.parametrize(
    "text",
    [
        HEAD + BC.replace('"bc"', '"planned_code:ALGORITHM"'),
        HEAD + BC + 'settings = { network = "planned_code:NETWORK" }',
        HEAD + BC + 'settings = { observation = "planned_code:OBSERVATION" }',
        HEAD
        + BC.replace('"bc"', '"object-bc"')
        + 'settings = { perception = "planned_code:FIND" }',
        'tasks = ["planned_code:TASK"]\n' + BC,
    ],
)
def test_a_plan_imports_no_module(
    text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "planned_code.py").write_text("raise SystemExit('imported')\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(PlanError, match=r"the plan names .*add to the command: --import planned_"):
        read_plan(write(tmp_path, text))


NETWORK = """
from types import SimpleNamespace
from torch import nn

NETWORK = SimpleNamespace(
    HIDDEN=(8,), make_convolutions=lambda channels, batch_norm: nn.Conv2d(channels, 2, 8, 8)
)
"""


def test_the_processes_of_a_plan_import_what_its_user_imported(
    tiny: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(plugins, "_imported", {})
    (tmp_path / "net_of_plan.py").write_text(NETWORK)
    text = tiny.read_text().replace("seeds = [0, 1]", "seeds = [0]")
    text = text.replace("{ batches", '{ network = "net_of_plan:NETWORK", batches')
    plan, out = write(tmp_path, text), tmp_path / "out"
    command = ["run", str(plan), "--out", str(out), "--workers", "1"]
    assert main(command) == 2
    assert main([*command, "--import", "net_of_plan"]) == 0


def test_a_wrong_plan_is_wrong_usage(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", str(tmp_path / "missing.toml")]) == 2
    assert (
        "missing.toml: expected a file with a plan in TOML, or one of paper, quick"
        in capsys.readouterr().err
    )
