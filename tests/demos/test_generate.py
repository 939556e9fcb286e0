"""Demonstrations from the scripted experts."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from magical.cli import main
from magical.demos import Dataset, DatasetWriter
from magical.demos.generate import demonstrate, generate
from magical.demos.trajectory import replay
from magical.envs.env import MagicalEnv
from magical.envs.seeds import episode_seed
from magical.errors import DatasetError, InvalidConfigError
from tests.demos.conftest import Run

ENV = "magical/MoveToRegion-TestAll-v0"


def bodies(path: Path) -> list[bytes]:
    return [t.bodies.tobytes() for t in Dataset.open(path)]


def test_result_depends_on_the_seed_alone(tmp_path: Path) -> None:
    for out, seed, workers in (("a", 7, 1), ("b", 7, 2), ("c", 8, 1)):
        generate(ENV, 2, tmp_path / out, seed=seed, workers=workers)
    assert bodies(tmp_path / "a") == bodies(tmp_path / "b")
    assert len({*bodies(tmp_path / "a"), *bodies(tmp_path / "c")}) == 4


def test_demonstration_matches_the_environment() -> None:
    trajectory = demonstrate(ENV, 5)
    env = MagicalEnv("MoveToRegion", "TestAll", observation="state")
    env.reset(seed=5)
    for action, expected in zip(trajectory.actions, trajectory.bodies[1:], strict=True):
        info = env.step(action)[-1]
        np.testing.assert_array_equal(env.bodies, expected)
    assert info["eval_score"] == trajectory.score
    assert (trajectory.demonstrator, trajectory.seed) == ("expert", 5)
    assert replay(trajectory).departure == 0.0


def test_perturbed_demonstrations_hold_both_actions_and_those_with_the_score_are_kept(
    tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    command = ("--env", ENV, "-n", 4, "--perturb", 0.5, "--min-score", 1.0, "--workers", 1)
    status, result = run("generate", *command, "--out", tmp_path)
    (report,) = result["environments"]
    assert (status, report["scores"]) == (0, [1.0] * 4)
    for trajectory in Dataset.open(tmp_path):
        made = demonstrate(ENV, trajectory.seed, perturb=0.5)
        assert trajectory.expert_actions.tolist() == made.labels.tolist()
        assert trajectory.actions.tolist() == made.actions.tolist()
        assert 0.2 < (trajectory.labels != trajectory.actions).mean() < 0.8
        assert replay(trajectory).departure == 0.0
        assert (trajectory.score, trajectory.metadata["perturb"]) == (1.0, 0.5)
    plain = demonstrate(ENV, episode_seed(0, 0))
    assert (plain.expert_actions, plain.metadata["perturb"]) == (None, 0.0)
    monkeypatch.setattr("magical.demos.generate.MAX_DROPPED", 1)
    with pytest.raises(DatasetError, match=r"attempts scored less than 1\.1"):
        generate(ENV, 2, tmp_path, min_score=1.1)


def test_a_share_outside_0_to_1_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["demos", "generate", "--env", ENV, "--perturb=much", "--out", str(tmp_path / "d")]
    assert main(command) == 2
    assert "--perturb: expected a number from 0 to 1, found 'much'" in capsys.readouterr().err
    for share in (1.5, float("nan")):
        with pytest.raises(InvalidConfigError, match="perturb: expected a number from 0 to 1"):
            generate(ENV, 1, tmp_path / "d", perturb=share)
    assert not (tmp_path / "d").exists()


def test_several_environments_append_and_repetitions_are_counted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], run: Run
) -> None:
    ids = ["magical/MoveToRegion-Demo-v0", "MoveToCorner-Demo-LoRes4E-v0"]
    command = ("generate", "--out", tmp_path, "--workers", 1, "-n", 1, "--env")
    status, result = run(*command, *ids)
    assert status == 0
    assert [r["env_id"] for r in result["environments"]] == [ids[0], "magical/MoveToCorner-Demo-v0"]
    assert [entry.task for entry in Dataset.open(tmp_path).entries] == [
        "MoveToRegion",
        "MoveToCorner",
    ]
    DatasetWriter(tmp_path).append(replace(Dataset.open(tmp_path)[0], seed=2))
    assert main(["demos", *map(str, command), ids[0]]) == 0
    assert "that duplicate earlier ones: 1" in capsys.readouterr().err
    assert main(["demos", *map(str, command), "MoveToMoon-Demo-v0"]) == 2


def test_an_interrupted_series_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    generate(ENV, 4, whole, perturb=0.3)
    generate(ENV, 1, parts, perturb=0.3)
    generate(ENV, 1, parts, perturb=0.3, first=1)
    generate(ENV, 1, parts)  # of another series
    made: list[int] = []

    def counted(env_id: str, seed: int, **more: Any) -> Any:
        made.append(seed)
        return demonstrate(env_id, seed, **more)

    monkeypatch.setattr("magical.demos.generate.demonstrate", counted)
    report = generate(ENV, 4, parts, perturb=0.3)
    assert (report.already, made) == (2, [episode_seed(0, 2), episode_seed(0, 3)])
    found = [t.bodies.tobytes() for t in Dataset.open(parts) if t.metadata["perturb"] == 0.3]
    assert found == bodies(whole)
