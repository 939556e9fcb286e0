"""The policies that the page offers: which runs are found, and what they do in an episode."""

import json
import subprocess
import sys
from collections.abc import Callable
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from magical.demos import DatasetWriter
from magical.demos.generate import demonstrate
from magical.envs import EnvId, parse_env_id
from magical.errors import (
    CheckpointError,
    InvalidConfigError,
    NotFoundError,
    PolicyError,
    RunFolderError,
)
from magical.tasks import TASKS
from magical_play.driver import Driver, Proposal, episode_probabilities, roll_out
from magical_play.episode import PlayedEpisode
from magical_play.policies import EXPERT, Policies

ENV = EnvId("MoveToRegion", "Demo")


def write_config(folder: Path, **content: object) -> None:
    folder.mkdir(parents=True)
    (folder / "config.json").write_text(json.dumps(content))


def test_runs_are_found_below_a_folder_and_keep_their_numbers(tmp_path: Path) -> None:
    write_config(tmp_path / "b", algorithm="bc", tasks=["MoveToRegion", "NoSuchTask"])
    policies = Policies([tmp_path])
    assert [entry.name for entry in policies.refresh()] == ["expert", "b"]
    assert policies.find(1).tasks == ("MoveToRegion",)
    write_config(tmp_path / "a" / "seed-0", algorithm="gail", tasks=["FindDupe"])
    write_config(tmp_path / "too" / "deep" / "for" / "us", algorithm="bc", tasks=[])
    found = policies.refresh()
    assert [entry.name for entry in found] == ["expert", "b", "a/seed-0"]
    assert found[2].algorithm == "gail"


def test_runs_of_two_folders_are_told_apart(tmp_path: Path) -> None:
    for folder in ("first/runs", "second/runs"):
        write_config(tmp_path / folder / "bc", algorithm="bc", tasks=[])
    policies = Policies([tmp_path / "first/runs", tmp_path / "second/runs"])
    assert [entry.name for entry in policies.refresh()] == ["expert", "runs/bc", "runs (2)/bc"]


def test_a_run_folder_itself_can_be_given(tmp_path: Path) -> None:
    write_config(tmp_path / "mine", algorithm="bc", tasks=[])
    assert Policies([tmp_path / "mine"]).find(1).name == "mine"


def test_generated_tasks_are_offered_where_a_player_starts_or_a_run_learned_them(
    tmp_path: Path,
) -> None:
    write_config(tmp_path / "mine", algorithm="bc", tasks=["Generated0004"])
    policies = Policies([tmp_path], ["Generated0003"])
    assert policies.tasks == (*TASKS, "Generated0003", "Generated0004")
    assert policies.find(0).tasks == policies.tasks
    assert roll_out(policies, 0, parse_env_id("magical/Generated0004-Demo-v0"), 0)


def test_a_run_may_be_named_like_a_policy_of_the_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    write_config(tmp_path / "random", algorithm="bc", tasks=["FindDupe"])
    with pytest.raises(InvalidConfigError, match="expected the setting demos"):  # read as a run
        Policies([Path()]).load(1)


def test_damaged_runs_are_listed_and_a_missing_folder_is_an_error(tmp_path: Path) -> None:
    write_config(tmp_path / "odd", algorithm="bc", tasks=7)
    (tmp_path / "text").mkdir()
    (tmp_path / "text" / "config.json").write_text("{")
    entries = Policies([tmp_path]).refresh()
    assert [entry.name for entry in entries] == ["expert", "odd (damaged)", "text (damaged)"]
    with pytest.raises(RunFolderError, match="no-such-folder"):
        Policies([tmp_path / "no-such-folder"])


def test_only_known_policies_act_and_only_in_their_tasks(tmp_path: Path) -> None:
    write_config(tmp_path / "mine", algorithm="bc", tasks=["FindDupe"])
    policies = Policies([tmp_path])
    for number in (-1, 2):
        with pytest.raises(NotFoundError, match=f"found number {number}"):
            policies.find(number)
    with pytest.raises(PolicyError, match="FindDupe; found magical/MoveToRegion-Demo-v0"):
        roll_out(policies, 1, ENV, 0)
    with pytest.raises(PolicyError, match="FindDupe"):
        Driver(policies, 1, ENV, 0)
    with pytest.raises(PolicyError, match="no action probabilities"):
        policies.load(EXPERT)


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Policies]:
    """A run of three batches of an algorithm, number 1, which is called `mine`."""
    pytest.importorskip("torch")
    from magical_baselines import find_algorithm, train

    folder = tmp_path_factory.mktemp("trained")
    DatasetWriter(folder / "demos").append(demonstrate(ENV, 1))

    @cache
    def policies(algorithm: str) -> Policies:
        config = find_algorithm(algorithm).config.preset(
            "quick",
            tasks=("MoveToRegion",),
            demos=str(folder / "demos"),
            num_demos=1,
            batches=3,
            network="light",
            device="cpu",
            threads=1,
        )
        train(config, folder / algorithm / "mine")
        return Policies([folder / algorithm])

    return policies


@pytest.fixture(scope="module")
def trained(runs: Callable[[str], Policies]) -> Policies:
    """Of behavioural cloning."""
    return runs("bc")


def test_a_watched_run_acts_as_in_its_rollout_with_the_same_probabilities(
    trained: Policies,
) -> None:
    seed = 11
    alone = roll_out(trained, 1, ENV, seed)
    judged = episode_probabilities(trained.load(1), alone)
    assert judged.shape == (len(alone), 18)
    np.testing.assert_allclose(judged.sum(axis=1), 1.0)
    driver, episode = Driver(trained, 1, ENV, seed), PlayedEpisode(ENV, seed)
    for action, row in zip(alone.actions.tolist(), judged, strict=True):
        proposal = driver.propose(*episode.seen)
        assert proposal.action == action
        np.testing.assert_allclose(proposal.probabilities or (), row, atol=1e-3)
        episode.step(proposal.action, driver.actor, proposal.action)
    assert alone.demonstrator == "mine"


@pytest.mark.parametrize("algorithm", ["act", "transformer-bc"])
def test_policies_with_memory_are_watched_side_by_side_without_probabilities(
    algorithm: str, runs: Callable[[str], Policies]
) -> None:
    policies, seeds = runs(algorithm), (11, 12)
    alone = [roll_out(policies, 1, ENV, seed) for seed in seeds]
    pairs = [(Driver(policies, 1, ENV, seed), PlayedEpisode(ENV, seed)) for seed in seeds]
    for actions in zip(*(each.actions.tolist() for each in alone), strict=True):
        for action, (driver, episode) in zip(actions, pairs, strict=True):
            assert driver.propose(*episode.seen) == Proposal(action)
            episode.step(action, driver.actor, action)
    with pytest.raises(PolicyError, match="found one with a memory"):
        episode_probabilities(policies.load(1), alone[0])


def test_policies_of_continuous_actions_are_refused(runs: Callable[[str], Policies]) -> None:
    with pytest.raises(PolicyError, match="mine: its actions are continuous"):
        roll_out(runs("diffusion"), 1, ENV, 0)


def test_a_state_that_is_asked_for_twice_gets_one_answer(trained: Policies) -> None:
    driver, episode = Driver(trained, 1, ENV, 11), PlayedEpisode(ENV, 11)
    first = driver.propose(*episode.seen)
    assert isinstance(first, Proposal)
    assert driver.propose(*episode.seen) is first


def test_a_new_checkpoint_is_loaded(trained: Policies) -> None:
    def network() -> Any:
        policy: Any = trained.load(1)
        return policy.network

    before = network()
    assert network() is before
    folder = trained.find(1).folder
    assert folder is not None
    checkpoint = folder / "checkpoint.safetensors"
    checkpoint.touch()
    assert network() is not before
    checkpoint.write_bytes(b"")
    with pytest.raises(CheckpointError):
        trained.load(1)


@pytest.mark.parametrize(
    ("arguments", "imported"), [("", False), ("[Path.cwd()]", find_spec("torch") is not None)]
)
def test_pytorch_is_imported_at_the_start_where_there_are_runs(
    tmp_path: Path, arguments: str, imported: bool
) -> None:
    program = f"""
import sys
from pathlib import Path
from magical_play.policies import Policies
Policies({arguments})
sys.exit(("torch" in sys.modules) is not {imported})
"""
    subprocess.run([sys.executable, "-c", program], cwd=tmp_path, check=True)
