"""The examples, with short settings, and the program of `docs/five-minutes.md`."""

import json
import re
import runpy
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from magical import cli
from magical.evaluation import environments, evaluate, load_policy
from magical.tasks import unregister_task


def example(root: Path, name: str) -> dict[str, Any]:
    """An example's names; its `main` has not run."""
    return runpy.run_path(str(root / "examples" / f"{name}.py"))


@pytest.fixture(scope="module")
def ninth_task(root: Path) -> Iterator[dict[str, Any]]:
    yield example(root, "ninth_task")
    unregister_task("Separate")


def test_third_party_policy(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    example(root, "third_party_policy")["main"](rollouts=4)
    means = {
        line.split()[0]: float(line.split()[1]) for line in capsys.readouterr().out.splitlines()
    }
    assert set(means) == {"Demo", "Jitter", "Layout", "Colour", "Dynamics", "All"}
    assert min(means.values()) >= 0.75


def test_third_party_policy_by_name(root: Path) -> None:
    policy = load_policy(f"{root / 'examples' / 'third_party_policy.py'}:SeekColour")
    scores = evaluate(policy, environments(policy.tasks, ["Demo"]), rollouts=1, workers=0)
    assert [row.score for row in scores] == [1.0]


def test_custom_scene(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert example(root, "custom_scene")["main"]() == 1.0
    assert "blue star: now at" in capsys.readouterr().out


def test_ninth_task(ninth_task: dict[str, Any], capsys: pytest.CaptureFixture[str]) -> None:
    ninth_task["main"](rollouts=2)
    printed = capsys.readouterr().out
    assert "observations (96, 96, 12)" in printed
    assert len(environments(["Separate"])) == 6


def test_ninth_task_scores(ninth_task: dict[str, Any]) -> None:
    from magical.scene import Poses

    scene, score = ninth_task["DEMO"], ninth_task["score"]
    poses = Poses.at_rest(scene)
    assert score(scene, poses) == 0.0
    poses.blocks[0, 0] = -0.5  # 0.65 apart: halfway from 0.3 to 1
    assert score(scene, poses) == pytest.approx(0.5)
    poses.blocks[0, 0] = -0.9
    assert score(scene, poses) == 1.0


@pytest.mark.filterwarnings("default")  # the libraries' own
@pytest.mark.parametrize(
    ("name", "library"),
    [
        ("stable_baselines3_ppo", "stable_baselines3"),
        ("torchrl_ppo", "torchrl"),
        ("pufferlib_ppo", "pufferlib"),
    ],
)
def test_ppo_of_other_libraries(
    name: str, library: str, root: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip(library, reason="not installed; the example says how")
    example(root, name)["main"](steps=1280, rollouts=2, workers=0)
    means = capsys.readouterr().out.splitlines()[-6:]
    assert [line.split()[0] for line in means] == [
        *("Demo", "Jitter", "Layout", "Colour", "Dynamics", "All")
    ]


def test_the_training_of_five_minutes_runs(root: Path, tmp_path: Path) -> None:
    pytest.importorskip("magical_baselines", reason="magical-baselines is not installed")
    page = root / "docs" / "five-minutes.md"
    (block,) = (
        text
        for text in re.findall(r"```python\n(.*?)```", page.read_text(), re.DOTALL)
        if "magical_baselines" in text
    )
    # The same program with less of everything.
    short = block.replace('"quick",', '"quick", batches=4,').replace("rollouts=100", "rollouts=2")
    assert short.count("batches=4") == short.count("rollouts=2") == 1
    done = subprocess.run(
        [sys.executable, "-c", short], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert len(done.stdout.splitlines()) == 6


def test_the_algorithm_of_the_documentation_trains(
    root: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    pytest.importorskip("magical_baselines", reason="magical-baselines is not installed")
    page = (root / "docs" / "how-to" / "algorithm.md").read_text()
    (block,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
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


def test_the_tutorial_runs(root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("magical_baselines", reason="magical-baselines is not installed")
    from tools.run_notebook import read_notebook, run_notebook

    notebook = read_notebook(root / "examples" / "tutorial.ipynb")
    codes = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    stored = [kinds(cell) for cell in codes]
    assert sum(kind == "image/png" for cell in stored for kind in cell) >= 4
    install, settings = codes[0]["source"], codes[1]["source"]
    assert install[4] == 'if importlib.util.find_spec("magical") is None:\n'
    assert settings[0] == 'TASK = "MoveToRegion"\n'
    # The same notebook with less of everything.
    short = {"NUM_DEMOS = 10": "NUM_DEMOS = 2", "BATCHES = 100": "BATCHES = 3"}
    for old, new in {**short, "ROLLOUTS = 10": "ROLLOUTS = 1"}.items():
        (line,) = (i for i, text in enumerate(settings) if text.startswith(old))
        settings[line] = settings[line].replace(old, new)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    run_notebook(notebook)
    assert [kinds(cell) for cell in codes] == stored
    table = "".join(codes[-2]["outputs"][0]["text"]).splitlines()
    assert [line.split()[0] for line in table[1:]] == ["random", "expert", "BC", "BC"]


def kinds(cell: dict[str, Any]) -> list[str]:
    """What a cell's outputs are."""
    return [next(iter(output.get("data", {"stdout": ""}))) for output in cell["outputs"]]


def test_the_tutorial_is_a_valid_notebook(root: Path) -> None:
    nbformat = pytest.importorskip("nbformat", reason="needs the extra dev")
    path = root / "examples" / "tutorial.ipynb"
    nbformat.validate(nbformat.read(path, as_version=4))
    assert path.stat().st_size < 1_000_000
    assert str(Path.home()) not in path.read_text()
