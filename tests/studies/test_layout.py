"""Scoring a test variant while a plan's runs train."""

from pathlib import Path

import pytest

from magical.demos.generate import generate
from magical.envs import EnvId
from magical.experiments.plan import planned_runs, read_plan
from magical.runs.folder import read_json
from studies.demonstrations import layout

PLAN = """
tasks = ["MoveToRegion"]
seeds = [0]
num_demos = 1
demos = "human"
preset = "quick"
threads = 1
rollouts = 1

[[methods]]
name = "GAIL tiny"
algorithm = "gail"

[methods.settings]
network = "narrow"
num_envs = 2
num_steps = 2
total_steps = 20
epochs = 1
discriminator_steps = 1
discriminator_batch_size = 2
evaluate_every = 0
"""


def test_a_variant_is_scored_at_every_stage(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plan, demos, out = tmp_path / "tiny.toml", tmp_path / "demos", tmp_path / "out"
    plan.write_text(PLAN)
    generate(EnvId("MoveToRegion", "Demo"), 1, demos, seed=0)
    command = [str(plan), "--demos", str(demos), "--out", str(out), "--rollouts", "1"]
    layout.main([*command, "--every", "8"])
    (run,) = planned_runs(read_plan(plan))
    folder = out / "runs" / run.folder
    curve = layout.read_curve(folder)
    assert [steps for steps, _ in curve] == [8, 16, 20]
    assert all(0.0 <= mean <= 1.0 for _, mean in curve)
    assert read_json(folder / "config.json")["total_steps"] == 20
    first = capsys.readouterr().out
    assert first.startswith("GAIL tiny, MoveToRegion, seed 0: ")
    layout.main([*command, "--every", "8"])  # nothing is left
    assert capsys.readouterr().out == first
    assert layout.read_curve(folder) == curve
    layout.main([*command, "--task", "FixColour"])


def test_a_plan_of_cloning_is_refused(tmp_path: Path) -> None:
    plan = tmp_path / "bc.toml"
    plan.write_text(PLAN.split("[[methods]]")[0] + '[[methods]]\nname = "BC"\nalgorithm = "bc"\n')
    with pytest.raises(SystemExit, match="bc takes no environment steps"):
        layout.main([str(plan), "--demos", str(tmp_path), "--out", str(tmp_path / "out")])
