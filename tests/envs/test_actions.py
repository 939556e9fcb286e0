"""Continuous actions: the space, what is refused, saved states, many environments."""

import json
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from numpy.typing import NDArray

from magical.envs.env import MagicalEnv
from magical.envs.vector import MagicalVectorEnv
from magical.errors import InvalidActionError, UnknownNameError
from magical.scene import to_continuous

TASK, VARIANT = "MatchRegions", "TestAll"
IDS = [f"magical/{TASK}-{VARIANT}-v0"] * 3
BAD = [
    ([np.nan, 0.0, 0.0], "found drive nan"),
    ([0.0, 1.0 + 1e-9, 0.0], "found turn 1"),
    ([0.0, 0.0, -np.inf], "found grip -inf"),
    ([0.0, 0.0], r"of shape \(1, 3\), found"),
    ([0.0, [0.0], 0.0], "of shape"),
    (["0", "0", "0"], "of shape"),
    ([True, False, True], "of shape"),
    (3, "of shape"),
    (None, "of shape"),
]


def make(action_space: Any = "continuous") -> MagicalEnv:
    env = MagicalEnv(TASK, VARIANT, observation="state", horizon=20, action_space=action_space)
    env.reset(seed=3)
    return env


def actions(count: int, rows: tuple[int, ...] = ()) -> NDArray[np.float32]:
    sampled = np.random.default_rng(0).uniform(-1.0, 1.0, (count, *rows, 3))
    return sampled.astype(np.float32)


def test_the_space_is_a_box_and_samples_are_actions() -> None:
    env = gym.make(IDS[0], action_space="continuous", observation="state")
    assert env.action_space == gym.spaces.Box(-1.0, 1.0, (3,), np.float32)
    env.reset(seed=0)
    env.step(env.action_space.sample())
    with pytest.raises(UnknownNameError, match="expected discrete or continuous"):
        gym.make(IDS[0], action_space="box")


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9, 1.0])
def test_speed_turning_and_grip_are_proportional(share: float) -> None:
    env = MagicalEnv("MoveToCorner", "Demo", observation="state", action_space="continuous")
    for action, speed, spin in (
        ([share, 0.0, 0.0], 0.8 * share, 0.0),
        ([-share, 0.0, 0.0], 0.6 * share, 0.0),
        ([0.0, share, 0.0], 0.0, 2.5 * share),
        ([0.0, -share, 0.0], 0.0, -2.5 * share),
    ):
        env.reset(seed=0)
        for _ in range(5):
            env.step(action)
        state = env.state()
        assert np.hypot(*state.velocities[0, :2]) == pytest.approx(speed, abs=1e-3)
        assert state.velocities[0, 2] == pytest.approx(spin, abs=1e-3)
    env.reset(seed=0)
    for _ in range(8):
        env.step([0.0, 0.0, 2 * share - 1])
    robot, left, right = env.state().poses.bodies[:3, 2]
    opening = np.pi / 8 * (1 - share)
    assert (left - robot, robot - right) == pytest.approx((opening, opening), abs=5e-3)


@pytest.mark.parametrize(("action", "message"), BAD)
def test_other_actions_are_named_and_change_nothing(action: Any, message: str) -> None:
    env = make()
    env.step([0.3, -0.2, 0.5])
    before = env.get_state()
    with pytest.raises(InvalidActionError, match=message):
        env.step(action)
    assert env.get_state() == before
    env.step([0.0, 0.0, 0.0])


def test_saved_states_continue_in_the_other_action_space() -> None:
    env, discrete = make(), make("discrete")
    for action in (1, 12, 17):
        discrete.step(action)
    env.set_state(json.loads(json.dumps(discrete.get_state())))
    assert env.get_state() == discrete.get_state()
    assert env.get_state()["actions"] == to_continuous([1, 12, 17]).tolist()
    for action in actions(5):
        env.step(action)
    discrete.set_state(env.get_state())
    np.testing.assert_array_equal(env.step([1.0, 1.0, -1.0])[0], discrete.step(4)[0])


@pytest.mark.parametrize("workers", [1, 2])
def test_a_vector_environment_acts_as_single_ones_do(workers: int) -> None:
    options: dict[str, Any] = {"observation": "state", "action_space": "continuous"}
    envs = MagicalVectorEnv(IDS, workers=workers, **options)
    assert envs.single_action_space == gym.spaces.Box(-1.0, 1.0, (3,), np.float32)
    single = [MagicalEnv(TASK, VARIANT, **options) for _ in IDS]
    observations, _ = envs.reset(seed=[3, 4, 5])
    expected = [env.reset(seed=seed)[0] for env, seed in zip(single, (3, 4, 5), strict=True)]
    active = np.array([True, False, True])
    for step, batch in enumerate(actions(6, (3,))):
        acting = active if step % 2 else None
        observations = envs.step(batch, acting)[0]
        for row, env in enumerate(single):
            if acting is None or acting[row]:
                expected[row] = env.step(batch[row])[0]
    np.testing.assert_array_equal(observations, expected)
    state = envs.get_state(2)
    assert state == single[2].get_state()
    envs.set_state(0, state)
    assert envs.get_state(0) == state
    envs.close()


def test_a_vector_environment_names_the_row_that_is_wrong_and_stays_as_it_is() -> None:
    envs = MagicalVectorEnv(IDS, workers=1, observation="state", action_space="continuous")
    envs.reset(seed=3)
    before = [envs.get_state(row) for row in range(3)]
    wrong = np.zeros((3, 3))
    wrong[1, 2] = np.nan
    with pytest.raises(InvalidActionError, match="found grip nan in row 1"):
        envs.step(wrong)
    with pytest.raises(InvalidActionError, match=r"of shape \(3, 3\)"):
        envs.step([0, 0, 0])
    assert [envs.get_state(row) for row in range(3)] == before


def test_keys_of_gymnasiums_play_are_points() -> None:
    keys = make().get_keys_to_action()
    assert keys["w", "a", " "].tolist() == [1.0, 1.0, 1.0]
    assert make("discrete").get_keys_to_action()["w",] == 1
