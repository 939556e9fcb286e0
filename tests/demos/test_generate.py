"""Demonstrations from the scripted experts."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

from magical.cli import main
from magical.demos import Dataset, DatasetWriter
from magical.demos.generate import demonstrate, generate
from magical.demos.trajectory import replay
from magical.envs.seeds import episode_seed
from magical.errors import DatasetError, InvalidConfigError, InvalidSceneError
from tests.demos.conftest import Run

ENV = "magical/MoveToRegion-TestAll-v0"


def poses(path: Path) -> list[bytes]:
    return [t.bodies.tobytes() for t in Dataset.open(path)]


def test_result_depends_on_the_seed_alone(tmp_path: Path) -> None:
    generate(ENV, 3, tmp_path / "a", seed=7, workers=1)
    generate(ENV, 3, tmp_path / "b", seed=7, workers=2)
    generate(ENV, 3, tmp_path / "c", seed=8, workers=1)
    assert poses(tmp_path / "a") == poses(tmp_path / "b")
    assert len(set(poses(tmp_path / "a") + poses(tmp_path / "c"))) == 6


def test_demonstration_matches_the_environment() -> None:
    seed = episode_seed(0, 5)
    trajectory = demonstrate(ENV, seed)
    env = gymnasium.make(ENV, observation="state")
    env.reset(seed=seed)
    for step, action in enumerate(trajectory.actions.tolist(), 1):
        *_, info = env.step(action)
        assert trajectory.poses is not None
        state = env.unwrapped.state()
        np.testing.assert_array_equal(state.poses.bodies, trajectory.poses[step])
    assert info["eval_score"] == trajectory.score
    assert (trajectory.demonstrator, trajectory.seed) == ("expert", seed)
    assert replay(trajectory).departure == 0.0


def test_only_demonstrations_with_the_score_are_kept(
    tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    command = ("--env", ENV, "-n", 4, "--perturb", 0.5, "--min-score", 1.0, "--workers", 1)
    status, result = run("generate", *command, "--out", tmp_path / "d")
    (report,) = result["environments"]
    assert (status, report["scores"]) == (0, [1.0] * 4)
    assert [t.score for t in Dataset.open(tmp_path / "d")] == report["scores"]
    assert {t.metadata["perturb"] for t in Dataset.open(tmp_path / "d")} == {0.5}
    monkeypatch.setattr("magical.demos.generate.MAX_DROPPED", 1)
    with pytest.raises(DatasetError, match=r"attempts scored less than 1\.1"):
        generate(ENV, 2, tmp_path / "d", min_score=1.1, workers=1)


def test_perturbed_demonstrations_hold_both_actions(tmp_path: Path, run: Run) -> None:
    command = ("generate", "--env", ENV, "-n", 3, "--perturb", 0.5, "--workers", 1)
    assert run(*command, "--out", tmp_path)[0] == 0
    for number, trajectory in enumerate(Dataset.open(tmp_path)):
        made = demonstrate(ENV, episode_seed(0, number), perturb=0.5)
        assert trajectory.expert_actions is not None
        assert trajectory.expert_actions.tolist() == made.labels.tolist()
        assert trajectory.actions.tolist() == made.actions.tolist()
        assert 0.2 < (trajectory.labels != trajectory.actions).mean() < 0.8
        assert replay(trajectory).departure == 0.0
        assert trajectory.metadata["perturb"] == 0.5
    plain = demonstrate(ENV, episode_seed(0, 0))
    assert plain.expert_actions is None
    assert plain.labels is plain.actions
    assert plain.metadata["perturb"] == 0.0


@pytest.mark.parametrize("share", ["1.5", "-0.1", "nan", "inf", "much"])
def test_a_share_outside_0_to_1_is_refused(
    share: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "d"
    command = ["demos", "generate", "--env", ENV, f"--perturb={share}", "--out", str(out)]
    assert main(command) == 2
    assert f"--perturb: expected a number from 0 to 1, found '{share}'" in capsys.readouterr().err
    if share != "much":
        with pytest.raises(InvalidConfigError, match="perturb: expected a number from 0 to 1"):
            generate(ENV, 1, out, perturb=float(share), workers=1)
        with pytest.raises(InvalidConfigError, match="perturb: expected a number from 0 to 1"):
            demonstrate(ENV, 0, perturb=float(share))
    assert not out.exists()


def test_no_demonstrations_and_negative_workers_are_refused(tmp_path: Path) -> None:
    for number, workers in ((0, 1), (1, 0)):
        with pytest.raises(ValueError, match="number, workers: expected at least 1"):
            generate("magical/MoveToCorner-Demo-v0", number, tmp_path / "d", workers=workers)


def test_several_environments_append(tmp_path: Path, run: Run) -> None:
    ids = ["magical/MoveToRegion-Demo-v0", "MoveToCorner-Demo-LoRes4E-v0"]
    status, result = run("generate", "--env", *ids, "-n", 2, "--out", tmp_path, "--workers", 1)
    assert status == 0
    assert [r["env_id"] for r in result["environments"]] == [ids[0], "magical/MoveToCorner-Demo-v0"]
    assert [entry.task for entry in Dataset.open(tmp_path).entries] == ["MoveToRegion"] * 2 + [
        "MoveToCorner"
    ] * 2
    assert main(["demos", "generate", "--env", "MoveToMoon-Demo-v0", "--out", str(tmp_path)]) == 2


def test_scene_without_solution_is_an_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def unsolvable(*_: Any, **__: Any) -> Any:
        raise InvalidSceneError("there is no duplicate")

    monkeypatch.setattr("magical.demos.generate.rollout", unsolvable)
    command = ["demos", "generate", "--env", ENV, "-n", "1", "--workers", "1"]
    assert main([*command, "--out", str(tmp_path / "d")]) == 1
    assert "there is no duplicate" in capsys.readouterr().err
    assert len(Dataset.open(tmp_path / "d")) == 0


def test_an_interrupted_series_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    generate(ENV, 4, whole, perturb=0.3)
    generate(ENV, 2, parts, perturb=0.3)
    generate(ENV, 1, parts)  # of another series
    made: list[int] = []

    def counted(env_id: str, seed: int, **more: Any) -> Any:
        made.append(seed)
        return demonstrate(env_id, seed, **more)

    monkeypatch.setattr("magical.demos.generate.demonstrate", counted)
    report = generate(ENV, 4, parts, perturb=0.3)
    assert (report.already, made) == (2, [episode_seed(0, 2), episode_seed(0, 3)])
    found = [t for t in Dataset.open(parts) if t.metadata["perturb"] == 0.3]
    expected = Dataset.open(whole)
    assert report.scores == tuple(t.score for t in expected)
    for ours, theirs in zip(found, expected, strict=True):
        np.testing.assert_array_equal(ours.bodies, theirs.bodies)


def test_a_series_can_go_on_from_any_attempt(tmp_path: Path) -> None:
    generate(ENV, 2, tmp_path, first=3)
    seeds = [entry.seed for entry in Dataset.open(tmp_path).entries]
    assert seeds == [episode_seed(0, 3), episode_seed(0, 4)]


def test_demonstrations_that_repeat_each_other_are_counted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for seed in (1, 2):  # the same two strategies in the same scene
        writer = DatasetWriter(tmp_path)
        writer.append(replace(demonstrate("MoveToRegion-Demo-v0", 5), seed=seed))
    command = ["generate", "--env", ENV, "-n", "1", "--workers", "1", "--out", str(tmp_path)]
    assert main(["demos", *command]) == 0
    assert "that duplicate earlier ones: 1" in capsys.readouterr().err
