"""Plans: the files of the repository, the runs that follow, and what is refused."""

import json
from collections import Counter

import pytest

from magical.errors import PlanError
from magical.evaluation import published_methods, published_tasks
from magical_baselines.experiments.plan import find_plan, planned_runs, read_plan

HEAD = 'tasks = ["MoveToCorner"]\npreset = "quick"\n'
BC = '[[methods]]\nname = "A"\nalgorithm = "bc"\n'


def write(folder, text):
    path = folder / "plan.toml"
    path.write_text(text)
    return path


def runs_of(folder, text, demos=None):
    return planned_runs(read_plan(write(folder, text), demos))


def test_the_papers_plan_is_the_appendix_grid():
    runs = planned_runs(read_plan(find_plan("paper")))
    assert len(runs) == 370
    assert {run.method for run in runs} == set(published_methods())
    counts = Counter(run.method for run in runs)
    assert {name for name, count in counts.items() if count == 5} == {"BC (MT)", "GAIL (MT)"}
    assert set(counts.values()) == {5, 40}
    assert {task for run in runs for task in run.tasks} == set(published_tasks())
    assert len({run.folder for run in runs}) == 370


def test_runs_are_methods_times_tasks_times_seeds(tmp_path):
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


def test_the_settings_of_a_run_are_what_its_scores_depend_on(tmp_path):
    def settings(text, demos=None):
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
        ("methods = []", "methods: expected array of length >= 1"),
        ("sedes = [1]\n" + BC, "expected the fields methods, tasks, seeds,.*found 'sedes'"),
        (BC + 'settings = { augmnt = "none" }', r"methods\[0\] \(A\): setting 'augmnt' is unk"),
        (BC + "settings = { seed = 1 }", r"\(A\): settings: expected seed in the plan"),
        (BC + 'settings = { batches = "9" }', r"\(A\): batches: expected int, found str"),
        (BC + "settings = { threads = 0 }", "threads: expected at least 1, found 0"),
        (BC.replace("bc", "bcc"), r"methods\[0\] \(A\): algorithm 'bcc' is unknown"),
        (BC.replace('"A"', '""'), r"methods\[0\].name: expected str of length >= 1"),
        (BC + BC.replace("A", "B"), "expected each run once, found the same settings twice"),
        (BC + BC.replace("A", "(a)"), r"the same folder twice: A, .*; \(a\), "),
        ('tasks = ["MoveToMoon"]\n' + BC, "MoveToMoon"),
        ("seeds = [0, 0]\n" + BC, "expected each run once"),
        ('variants = ["Weather"]\n' + BC, "'Weather' is not a variant"),
        ("nudge = 1\n" + BC, "nudge: expected float <="),
        ('horizon = "long"\n' + BC, "horizon: expected appendix, published or a number"),
        ('demos = "human"\nperturb = 0.2\n' + BC, "expected 0 for a dataset"),
        ("add_expert = true\n" + BC, "add_expert: expected demos, or --demos, to be a folder"),
        ("num_demos = 30\n" + BC, "expert_demos: expected at least num_demos, 30, found 25"),
        (
            BC.replace('"bc"', '"wgail-gp"\nmulti_task = true'),
            r"\(A\): wgail-gp: expected one task",
        ),
    ],
)
def test_a_wrong_plan_is_refused_with_file_and_key(tmp_path, text, message):
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
def test_a_plan_imports_no_module(text, tmp_path, monkeypatch):
    (tmp_path / "planned_code.py").write_text("raise SystemExit('imported')\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(PlanError, match=r"the plan names .*add to the command: --import planned_"):
        read_plan(write(tmp_path, text))
