"""Vector environments: options, and invalid arguments."""

import re
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import pytest

from magical.envs import EnvId
from magical.envs.vector import MagicalVectorEnv
from magical.errors import (
    ClosedEnvironmentError,
    InvalidActionError,
    MismatchedSpacesError,
    ResetNeededError,
    UnknownNameError,
)
from magical.observe.state_vector import StateSpec
from magical.scene.actions import NUM_ACTIONS
from tests.envs.vector.making import vector


def test_make_vec_passes_options() -> None:
    envs: Any = gymnasium.make_vec(
        "magical/MatchRegions-TestJitter-LoRes4A-v0",
        num_envs=2,
        workers=0,
        observation="state",
        horizon=2,
        reward="score",
        autoreset_mode="SameStep",
        copy=False,
    )
    assert isinstance(envs, MagicalVectorEnv)
    assert envs.env_ids == ("magical/MatchRegions-TestJitter-v0",) * 2
    assert (envs.workers, envs.copy, envs.num_envs) == (0, False, 2)
    assert envs.spec is not None
    envs.reset(seed=0)
    envs.step([0, 0])
    assert "final_obs" in envs.step([0, 0])[4]


def test_presets_in_ids_apply_unless_an_observation_is_given() -> None:
    envs = MagicalVectorEnv(["magical/MakeLine-Demo-LoResCHW4E-v0"] * 2, workers=0)
    assert envs.single_observation_space.shape == (12, 96, 96)
    assert envs.env_ids == ("magical/MakeLine-Demo-v0",) * 2
    with pytest.raises(MismatchedSpacesError, match="LoRes4A, LoRes4E"):
        MagicalVectorEnv(["MakeLine-Demo-LoRes4A-v0", "MakeLine-Demo-LoRes4E-v0"], workers=0)


def test_state_vectors_of_several_tasks_are_refused_by_their_shapes() -> None:
    with pytest.raises(MismatchedSpacesError, match=r"found shape \(75,\) \(MakeLine\) and \(132,"):
        vector(env_ids=["MakeLine-Demo-v0", "FindDupe-Demo-v0"])


def test_wrong_options_are_refused() -> None:
    for wrong, error in (
        ({"env_ids": []}, ValueError),
        ({"env_ids": "magical/MakeLine-Demo-v0"}, ValueError),
        ({"env_ids": ["magical/MakeLine-TestLyout-v0"]}, UnknownNameError),
        ({"env_ids": [EnvId("MoveToCorner", "TestLayout")]}, UnknownNameError),
        ({"workers": -1}, ValueError),
        ({"horizon": 0}, ValueError),
        ({"reward": "sparse"}, UnknownNameError),
        ({"render_mode": "human"}, UnknownNameError),
    ):
        with pytest.raises(error):
            vector(**wrong)
    with pytest.raises(UnknownNameError, match="expected one of: NextStep, SameStep, Disabled"):
        vector(autoreset_mode="same_step")


def test_workers_make_state_vectors_of_any_size() -> None:
    envs = vector(workers=1, observation=StateSpec(20, 8))
    given = vector(observation=StateSpec(20, 8))
    np.testing.assert_array_equal(envs.reset(seed=0)[0], given.reset(seed=0)[0])
    envs.close()


@pytest.mark.parametrize(
    ("actions", "found"),
    [
        ([0, 0], "[0, 0]"),
        (np.zeros((1, 3), int), "<array of shape (1, 3), i64>"),
        ([0, 0, NUM_ACTIONS], "18 in row 2"),
        ([0, -1, 20], "-1 in row 1"),
        ([0.0, 0.5, 0.0], "[0.0, 0.5, 0.0]; sample or take the argmax"),
        ([True, False, True], "[True, False, True]"),
        ([[0], [0, 1], 0], "[<list of 1>, <list of 2>, 0]"),
        ("abc", "'abc'"),
        (None, "None"),
    ],
)
def test_wrong_actions_are_refused_and_nothing_happens(actions: Any, found: str) -> None:
    envs = vector()
    envs.reset(seed=0)
    message = re.escape(f"actions: expected 3 integers from 0 to 17, found {found}")
    with pytest.raises(InvalidActionError, match=message):
        envs.step(actions)
    assert [state.step for state in envs.states()] == [0, 0, 0]
    envs.step([0, 0, 0])


def test_wrong_seeds_and_masks_are_refused() -> None:
    envs = vector()
    for seed in ([1, 2], -1, 1.5, ["a", "b", "c"]):
        with pytest.raises(ValueError, match="seed: expected"):
            envs.reset(seed=seed)  # type: ignore[arg-type]
    for mask in (np.zeros(3, np.bool_), np.ones(2, np.bool_), np.ones(3)):
        with pytest.raises(ValueError, match="reset_mask: expected bool"):
            envs.reset(options={"reset_mask": mask})


def test_calls_at_the_wrong_time_are_refused() -> None:
    envs = vector()
    calls: list[Callable[[], Any]] = [envs.states, lambda: envs.bodies, lambda: envs.get_state(0)]
    for call in calls:
        with pytest.raises(ResetNeededError):
            call()
    with pytest.raises(
        ResetNeededError, match="step: expected a running episode in every environment"
    ):
        envs.step([0, 0, 0])
    envs.reset(options={"reset_mask": np.array([True, False, True])})
    with pytest.raises(ResetNeededError, match="in 1 of 3"):
        envs.step([0, 0, 0])
    envs.get_state(2)
    envs.reset()
    envs.close()
    envs.close()
    for call in (*calls, envs.reset, lambda: envs.step([0, 0, 0])):
        with pytest.raises(ClosedEnvironmentError):
            call()


def test_gymnasiums_wrappers_and_specs_work() -> None:
    options: dict[str, Any] = {"observation": "state", "horizon": 3}
    made: Any = gymnasium.make_vec("magical/MoveToCorner-Demo-v0", 2, workers=0, **options)
    again: Any = gymnasium.make_vec(made.spec)
    assert (again.num_envs, again.workers, again.env_ids) == (2, 0, made.env_ids)
    envs = gymnasium.wrappers.vector.RecordEpisodeStatistics(made)
    envs.reset(seed=0)
    for _ in range(3):
        infos = envs.step(np.array([1, 1]))[4]
    assert infos["episode"]["l"].tolist() == [3, 3]
    listed = gymnasium.wrappers.vector.DictInfoToList(again)
    start: dict[str, Any] = {"eval_score": 0.0, "published_code_score": 0.0, "is_success": False}
    start["instruction"] = "Push the red square to the top left corner."
    assert listed.reset(seed=0)[1] == [start] * 2
