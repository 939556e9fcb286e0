"""Demonstrations from the scripted experts."""

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

from magical.cli import main
from magical.demos import Dataset
from magical.demos.generate import demonstrate, generate
from magical.demos.replay import replay
from magical.envs.seeds import episode_seed
from magical.errors import DatasetError, InvalidConfigError, InvalidSceneError
from tests.demos.conftest import Run

ENV = "magical/MoveToRegion-TestAll-v0"


def poses(path: Path) -> list[bytes]:
    return [t.poses.tobytes() for t in Dataset.open(path) if t.poses is not None]


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
        state = env.unwrapped.state()  # type: ignore[attr-defined]
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
    assert (status, report["kept"]) == (0, 4)
    assert report["scores"] == [1.0] * 4
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
    for number, workers, message in ((0, 1, "number: expected"), (1, -1, "workers: expected")):
        with pytest.raises(ValueError, match=message):
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


def test_repeated_demonstrations_are_reported_and_a_series_can_go_on(
    tmp_path: Path, run: Run, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ("generate", "--env", ENV, "-n", 2, "--workers", 1, "--out")
    run(*arguments, tmp_path / "d")
    capsys.readouterr()
    argv = ["demos", *map(str, arguments), str(tmp_path / "d")]
    assert main([*argv, "--first", "2"]) == 0
    assert "that duplicate earlier ones" not in capsys.readouterr().err
    assert [e.seed for e in Dataset.open(tmp_path / "d").entries] == [
        episode_seed(0, k) for k in range(4)
    ]
    assert main(argv) == 0
    assert "demonstrations that duplicate earlier ones: 2" in capsys.readouterr().err
    assert main([*argv, "--first", "8"]) == 0
    assert "that duplicate earlier ones" not in capsys.readouterr().err
