"""The examples, with short settings, and the programs of the documentation that train."""

import json
import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

from magical import cli
from magical.evaluation import environments, evaluate, load_policy
from magical.scene import Poses
from magical.tasks import unregister_task

VARIANTS = ["Demo", "Jitter", "Layout", "Colour", "Dynamics", "All"]  # of MoveToRegion


def example(root, name):
    """An example's names; its `main` has not run."""
    return runpy.run_path(str(root / "examples" / f"{name}.py"))


def test_third_party_policy(root, capsys):
    example(root, "third_party_policy")["main"](rollouts=4)
    means = dict(line.split()[:2] for line in capsys.readouterr().out.splitlines())
    assert list(means) == VARIANTS
    assert min(map(float, means.values())) >= 0.75


def test_third_party_policy_by_name(root):
    policy = load_policy(f"{root / 'examples' / 'third_party_policy.py'}:SeekColour")
    scores = evaluate(policy, environments(policy.tasks, ["Demo"]), rollouts=1, workers=0)
    assert [row.score for row in scores] == [1.0]


def test_custom_scene(root, capsys):
    assert example(root, "custom_scene")["main"]() == 1.0
    assert "blue star: now at" in capsys.readouterr().out


def test_ninth_task(root, capsys):
    task = example(root, "ninth_task")
    try:
        task["main"](rollouts=1)
        assert "observations (96, 96, 12)" in capsys.readouterr().out
        assert len(environments(["Separate"])) == 6
    finally:
        unregister_task("Separate")
    scene, score = task["DEMO"], task["score"]
    poses = Poses.at_rest(scene)
    for x, expected in ((poses.blocks[0, 0], 0.0), (-0.5, 0.5), (-0.9, 1.0)):
        poses.blocks[0, 0] = x  # 0.65 apart, halfway from 0.3 to 1, in the second case
        assert score(scene, poses) == pytest.approx(expected)


@pytest.mark.filterwarnings("default")  # the libraries' own
@pytest.mark.parametrize(
    ("name", "library"),
    [
        ("stable_baselines3_ppo", "stable_baselines3"),
        ("torchrl_ppo", "torchrl"),
        ("pufferlib_ppo", "pufferlib"),
    ],
)
def test_ppo_of_other_libraries(name, library, root, capsys):
    pytest.importorskip(library, reason="not installed; the example says how")
    example(root, name)["main"](steps=1280, rollouts=1, workers=0)
    lines = capsys.readouterr().out.splitlines()[-6:]
    assert [line.split()[0] for line in lines] == VARIANTS


def shortened(code, **settings):
    """The same program with less of everything: each text is replaced, once."""
    for old, new in settings.items():
        code, count = re.subn(rf"\b{old}\s?=\s?\d+", f"{old}={new}", code)
        assert count == 1, old
    return code


def test_the_training_of_getting_started_runs(root, tmp_path):
    pytest.importorskip("magical_baselines", reason="magical-baselines is not installed")
    page = (root / "docs" / "getting-started.md").read_text()
    (block,) = (
        text
        for text in re.findall(r"```python\n(.*?)```", page, re.DOTALL)
        if "magical_baselines" in text
    )
    code = shortened(block.replace('"quick",', '"quick", batches=0,'), batches=4, rollouts=1)
    run = [sys.executable, "-c", code]
    done = subprocess.run(run, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert [line.split()[0] for line in done.stdout.splitlines()] == VARIANTS


def test_the_algorithm_of_the_documentation_trains(root, tmp_path, monkeypatch, capsys):
    pytest.importorskip("magical_baselines", reason="magical-baselines is not installed")
    page = (root / "docs" / "extend.md").read_text()
    (block,) = re.findall(r"```python\n(# my_bc.py\n.*?)```", page, re.DOTALL)
    (tmp_path / "my_bc.py").write_text(block)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    train = "train my_bc:ALGORITHM --out run"
    compute = "--threads 1 --precision bfloat16 --device cpu"
    for command in (
        "demos generate --env magical/MoveToRegion-Demo-v0 -n 1 --out demos",
        f"{train} --task MoveToRegion --demos demos --num-demos 1 --batches 3 --stop-after 2 "
        f"{compute}",
        f"{train} --resume",
        "evaluate run --variants Demo --rollouts 1 --workers 0",
    ):
        assert cli.main(command.split()) == 0
    recorded = json.loads((tmp_path / "run" / "run.json").read_text())["compute"]
    assert recorded == {"device": "cpu", "precision": "bfloat16", "threads": 1}
    state = f"{train}2 --task MoveToRegion --demos demos --observation state"
    assert cli.main(state.split()) == 2
    assert "'state' is not taken by my_bc:ALGORITHM" in capsys.readouterr().err


def test_the_tutorial_runs(root, tmp_path, monkeypatch):
    pytest.importorskip("magical_baselines", reason="magical-baselines is not installed")
    from tools.run_notebook import read_notebook, run_notebook

    path = root / "examples" / "tutorial.ipynb"
    assert path.stat().st_size < 1_000_000
    assert str(Path.home()) not in path.read_text()
    nbformat = pytest.importorskip("nbformat", reason="needs the extra dev")
    nbformat.validate(nbformat.read(path, as_version=4))
    notebook = read_notebook(path)
    codes = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    stored = [kinds(cell) for cell in codes]
    assert sum(kind == "image/png" for cell in stored for kind in cell) >= 4
    settings = shortened("".join(codes[1]["source"]), NUM_DEMOS=2, BATCHES=3, ROLLOUTS=1)
    codes[1]["source"] = settings.splitlines(keepends=True)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    run_notebook(notebook)
    assert [kinds(cell) for cell in codes] == stored
    table = "".join(codes[-2]["outputs"][0]["text"]).splitlines()
    assert [line.split()[0] for line in table[1:]] == ["random", "expert", "BC", "BC"]


def kinds(cell):
    """What a cell's outputs are."""
    return [next(iter(output.get("data", {"stdout": ""}))) for output in cell["outputs"]]
