"""The policies that the page offers: which runs are found, and what they do in an episode."""

import json
from pathlib import Path

import numpy as np
import pytest

from magical import cli
from magical.demos import DatasetWriter
from magical.demos.generate import demonstrate
from magical.envs import EnvId
from magical.envs.env import MagicalEnv
from magical.errors import PolicyError, RunFolderError
from magical_play import policies as policies_module
from magical_play.episodes import PlayedEpisode
from magical_play.policies import Policies
from play.tests.serving import ENV


def write_config(folder):
    folder.mkdir(parents=True)
    (folder / "config.json").write_text(json.dumps({}))


def test_runs_are_found_below_folders_and_keep_their_numbers(tmp_path):
    write_config(tmp_path / "runs" / "b")
    write_config(tmp_path / "mine")
    policies = Policies([tmp_path / "runs", tmp_path / "mine"])
    first = ["expert", str(tmp_path / "runs" / "b"), str(tmp_path / "mine")]
    assert policies.names() == first
    write_config(tmp_path / "runs" / "a" / "seed-0")
    write_config(tmp_path / "runs" / "too" / "deep" / "for" / "us")
    assert policies.names() == [*first, str(tmp_path / "runs" / "a" / "seed-0")]
    with pytest.raises(PolicyError, match="a number up to 3, found 4"):
        policies.driver(4, PlayedEpisode(ENV, 11))
    with pytest.raises(RunFolderError, match="no-such-folder"):
        Policies([tmp_path / "no-such-folder"])


def choices(policies):
    """What a server's first run chooses in an episode in which it acts."""
    episode = PlayedEpisode(ENV, 11)
    driver = policies.driver(1, episode)
    while episode.steps < episode.length:
        driver.ask()
        assert driver.error is None
        episode.act(driver.choice, driver.actor, driver.choice)
    return episode.actions


def problem(policies, env_id=ENV):
    """Why a server's first run cannot act."""
    driver = policies.driver(1, PlayedEpisode(env_id, 11))
    driver.ask()
    return str(driver.error)


@pytest.fixture
def loaded(tmp_path, monkeypatch):
    """Makes a server's policies, of which the first run acts as a given policy."""
    write_config(tmp_path / "random")  # also the name of a policy
    monkeypatch.chdir(tmp_path)

    def policies(policy):
        monkeypatch.setattr(policies_module, "load_policy", {tmp_path / "random": policy}.get)
        found = Policies([Path("random")])
        assert found.names() == ["expert", "random"]
        return found

    return policies


class Recorder:
    """A policy that records its observations, and acts at random."""

    def __init__(self, observation, shape=(1,), actions=18):
        self.observation, self.shape, self.actions, self.seen = observation, shape, actions, []

    def act(self, observations, env_ids, rng):
        assert env_ids == [ENV]
        self.seen.append(np.array(observations))
        return rng.integers(self.actions, size=self.shape)

    def reset(self, mask):
        assert mask.tolist() == [True]


@pytest.mark.parametrize("observation", ["LoRes4E", "state"])
def test_a_policy_sees_what_the_environment_returns(observation, loaded):
    policy = Recorder(observation)
    actions = choices(loaded(policy))
    env = MagicalEnv("MoveToRegion", "Demo", observation=observation)
    returned = [env.reset(seed=11)[0], *(env.step(action)[0] for action in actions)]
    np.testing.assert_array_equal(np.concatenate(policy.seen), returned[:-1])
    assert choices(loaded(policy)) == actions  # the same seed


def test_what_is_no_action_is_an_error(loaded):
    for policy in (Recorder("state", shape=(1, 3)), Recorder("state", actions=10**9)):
        assert problem(loaded(policy)).startswith("expected an action from 0 to 17, found [")


def test_a_trained_run_is_watched(tmp_path):
    pytest.importorskip("magical_baselines")
    DatasetWriter(tmp_path / "demos").append(demonstrate(ENV, 1))
    run, demos = str(tmp_path / "runs" / "mine"), str(tmp_path / "demos")
    options = "--task MoveToRegion --preset quick --batches 3 --num-demos 1 --device cpu"
    command = ["train", "bc", "--out", run, "--demos", demos, *options.split()]
    assert cli.main(command) == 0
    policies = Policies([tmp_path / "runs"])
    assert policies.names() == ["expert", run]
    assert len(choices(policies)) == 40
    found = problem(policies, EnvId("FindDupe", "Demo"))
    assert "MoveToRegion; found magical/FindDupe-Demo-v0" in found
