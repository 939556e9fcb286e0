"""The policies that the page offers: which runs are found, and what they do in an episode."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from magical import cli
from magical.envs import EnvId
from magical.errors import PolicyError, RunFolderError
from magical_play import policies as policies_module
from magical_play.episodes import PlayedEpisode
from magical_play.policies import Policies

ENV = EnvId("MoveToRegion", "Demo")


def write_config(folder: Path) -> None:
    folder.mkdir(parents=True)
    (folder / "config.json").write_text(json.dumps({}))


def test_runs_are_found_below_folders_and_keep_their_numbers(tmp_path: Path) -> None:
    write_config(tmp_path / "runs" / "b")
    write_config(tmp_path / "mine")
    policies = Policies([tmp_path / "runs", tmp_path / "mine"])
    first = ["expert", str(tmp_path / "runs" / "b"), str(tmp_path / "mine")]
    assert policies.names() == first
    write_config(tmp_path / "runs" / "a" / "seed-0")
    write_config(tmp_path / "runs" / "too" / "deep" / "for" / "us")
    assert policies.names() == [*first, str(tmp_path / "runs" / "a" / "seed-0")]
    episode = PlayedEpisode(ENV, 11)
    assert policies.driver(2, episode).name == str(tmp_path / "mine")
    with pytest.raises(PolicyError, match="a number up to 3, found 4"):
        policies.driver(4, episode)
    with pytest.raises(RunFolderError, match="no-such-folder"):
        Policies([tmp_path / "no-such-folder"])


def choices(policies: Policies) -> list[int]:
    """What a server's first run chooses in an episode in which it acts."""
    episode = PlayedEpisode(ENV, 11)
    driver = policies.driver(1, episode)
    while episode.steps < episode.length:
        driver.ask()
        assert driver.error is None
        assert driver.choice is not None
        episode.act(driver.choice, driver.actor, driver.choice)
    return episode.actions


def problem(policies: Policies, env_id: EnvId = ENV) -> str:
    """Why a server's first run cannot act."""
    driver = policies.driver(1, PlayedEpisode(env_id, 11))
    driver.ask()
    return str(driver.error)


@pytest.fixture
def loaded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Makes a server's policies, of which the first run acts as a given policy."""
    write_config(tmp_path / "random")

    def policies(policy: object) -> Policies:
        def load(folder: Path) -> object:
            assert folder.is_absolute()  # "random" is also the name of a policy
            return policy

        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr(policies_module, "load_policy", load)
        found = Policies([Path("random")])
        assert found.names() == ["expert", "random"]
        return found

    return policies


class Recorder:
    """A policy that records its observations, and acts at random."""

    def __init__(self, observation: str, actions: int = 18) -> None:
        self.observation, self.actions = observation, actions
        self.seen: list[Any] = []

    def act(self, observations: Any, env_ids: list[EnvId], rng: np.random.Generator) -> Any:
        assert env_ids == [ENV]
        self.seen.append(np.array(observations))
        return rng.integers(self.actions, size=1)

    def reset(self, mask: Any) -> None:
        assert mask.tolist() == [True]
        self.seen.clear()


@pytest.mark.parametrize("observation", ["LoRes4E", "state"])
def test_a_policy_sees_what_the_environment_returns_whoever_acts(
    observation: str, loaded: Any
) -> None:
    from magical.envs.env import MagicalEnv

    policy = Recorder(observation)
    actions = choices(loaded(policy))
    env = MagicalEnv("MoveToRegion", "Demo", observation=observation)
    returned = [env.reset(seed=11)[0], *(env.step(action)[0] for action in actions)]
    for seen, expected in zip(policy.seen, returned, strict=False):
        np.testing.assert_array_equal(seen, expected[None])
    assert len(policy.seen) == len(actions) == 40
    assert choices(loaded(policy)) == actions  # the same seed


def test_what_is_no_action_is_an_error(loaded: Any) -> None:
    class Continuous(Recorder):
        def act(self, *_: Any) -> Any:
            return np.zeros((1, 3))

    for policy in (Continuous("state"), Recorder("state", actions=10**9)):
        assert problem(loaded(policy)).startswith("expected an action from 0 to 17, found [")


def test_a_trained_run_is_watched(tmp_path: Path) -> None:
    pytest.importorskip("magical_baselines")
    pytest.importorskip("torch")
    from magical.demos import DatasetWriter
    from magical.demos.generate import demonstrate

    DatasetWriter(tmp_path / "demos").append(demonstrate(ENV, 1))
    training = [
        *("--task", "MoveToRegion", "--preset", "quick", "--batches", "3"),
        *("--num-demos", "1", "--device", "cpu", "--demos", str(tmp_path / "demos")),
    ]
    assert cli.main(["train", "bc", "--out", str(tmp_path / "runs" / "mine"), *training]) == 0
    policies = Policies([tmp_path / "runs"])
    assert policies.names() == ["expert", str(tmp_path / "runs" / "mine")]
    assert len(choices(policies)) == 40
    assert "MoveToRegion; found magical/FindDupe-Demo-v0" in problem(
        policies, EnvId("FindDupe", "Demo")
    )
