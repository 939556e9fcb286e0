"""Recording policies, wrapped environments and keyboard play."""

import os
from pathlib import Path
from typing import Any

import gymnasium
import pytest
from gymnasium.wrappers import Autoreset, RecordEpisodeStatistics, TimeLimit, TransformAction

from magical.demos import Dataset, RecordTrajectories
from magical.demos.trajectory import replay
from magical.errors import DatasetError, TrajectoryError

ENV = "magical/MoveToRegion-TestDynamics-v0"


def make(horizon: int = 6, **options: Any) -> gymnasium.Env[Any, Any]:
    return gymnasium.make(ENV, horizon=horizon, observation="state", **options)


def test_complete_episodes_are_stored_with_provenance(tmp_path: Path) -> None:
    env = RecordTrajectories(make(), tmp_path, demonstrator="random")
    env.reset(seed=0)
    env.step(1)  # an unfinished episode is not stored
    infos = []
    for seed in (4, None):
        env.reset(seed=seed)
        infos.append([env.step(action)[-1] for action in range(6)][-1])
    first, second = Dataset.open(tmp_path)
    assert (first.seed, second.seed) == (4, None)
    assert (first.env_id, first.demonstrator, len(first)) == (ENV, "random", 6)
    assert [first.score, second.score] == [info["eval_score"] for info in infos]
    assert {"magical", "pymunk", "numpy"} <= set(first.metadata["versions"])
    assert first.dynamics != second.dynamics
    assert [replay(t).departure for t in (first, second)] == [0.0, 0.0]


def test_an_episode_that_a_wrapper_ends_is_stored_once(tmp_path: Path) -> None:
    env = RecordTrajectories(TimeLimit(make(), 2), tmp_path, demonstrator="x")
    env.reset(seed=0)
    assert [env.step(1)[3] for _ in range(2)] == [False, True]
    with pytest.raises(TrajectoryError, match="reset"):
        env.step(1)
    assert [len(trajectory) for trajectory in Dataset.open(tmp_path)] == [2]


def test_wrappers_inside_and_around(tmp_path: Path) -> None:
    """One changes the actions, one resets."""
    mirror = TransformAction(make(horizon=2), lambda a: 17 - a, gymnasium.spaces.Discrete(18))
    env = RecordTrajectories(Autoreset(mirror), tmp_path, demonstrator="x")
    env = RecordEpisodeStatistics(env)
    env.reset(seed=4)
    for _ in range(6):  # two steps, and one that resets
        env.step(1)
    first, second = Dataset.open(tmp_path)
    assert (first.seed, second.seed) == (4, None)
    assert first.actions.tolist() == second.actions.tolist() == [16, 16]
    assert [replay(t).departure for t in (first, second)] == [0.0, 0.0]


def test_set_state_in_an_episode_is_refused(tmp_path: Path) -> None:
    env = RecordTrajectories(make(), tmp_path, demonstrator="x")
    env.reset(seed=0)
    env.unwrapped.set_state(env.unwrapped.get_state())
    with pytest.raises(TrajectoryError, match="not recorded from its start"):
        env.step(1)


def test_other_environments_and_folders_are_refused(tmp_path: Path) -> None:
    with pytest.raises(TrajectoryError, match="magical's environments"):
        RecordTrajectories(gymnasium.make("CartPole-v1"), tmp_path, demonstrator="x")
    (tmp_path / "file").touch()
    with pytest.raises(DatasetError, match="cannot be written"):
        RecordTrajectories(make(), tmp_path / "file", demonstrator="x")


def test_play_is_recorded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(os.environ, "SDL_VIDEODRIVER", "dummy")
    pygame = pytest.importorskip("pygame")
    from gymnasium.utils.play import play

    env = RecordTrajectories(
        make(horizon=4, render_mode="rgb_array"), tmp_path, demonstrator="player"
    )

    def press(*step: Any) -> None:
        if len(Dataset.open(tmp_path)) == 1:
            pygame.event.post(pygame.event.Event(pygame.QUIT))
        else:
            pygame.event.post(pygame.event.Event(pygame.KEYDOWN, key=ord("w")))

    play(env, fps=1000, callback=press, seed=3)
    pygame.quit()
    (trajectory,) = Dataset.open(tmp_path)
    assert (trajectory.demonstrator, trajectory.seed) == ("player", 3)
    assert trajectory.actions.tolist() == [0, 1, 1, 1]
