"""The interface of every registered environment."""

import json
import warnings
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import magical
from magical.envs.env import MagicalEnv
from magical.scene import to_continuous
from magical.tasks.scoring import SUCCESS

ENV_IDS = magical.all_env_ids()
# What a preset changes does not depend on the variant.
DEMO_IDS = [env_id for env_id in magical.all_env_ids(presets=True) if env_id.variant == "Demo"]


def _make(env_id: str, **options: Any) -> MagicalEnv:
    env = gym.make(env_id, **options).unwrapped
    assert isinstance(env, MagicalEnv)
    return env


@pytest.mark.parametrize("env_id", dict.fromkeys([*ENV_IDS, *DEMO_IDS]))
def test_gymnasium_s_checker_reports_nothing(env_id: str) -> None:
    """Among others, equal seeds and actions lead to equal observations."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(gym.make(env_id, render_mode="rgb_array").unwrapped, skip_render_check=False)


@pytest.mark.parametrize("env_id", [env_id for env_id in DEMO_IDS if env_id.preset is None])
def test_discrete_actions_are_points_of_the_continuous_ones(env_id: str) -> None:
    envs = [_make(env_id, observation="state", action_space=a) for a in ("discrete", "continuous")]
    for env in envs:
        env.reset(seed=5)
    order = np.random.default_rng(0).permutation(np.tile(np.arange(18), 2))
    for action, point in zip(order.tolist(), to_continuous(order), strict=True):
        for env, given in zip(envs, (action, point), strict=True):
            env.step(given)
        np.testing.assert_array_equal(envs[0].bodies, envs[1].bodies, err_msg=f"action {action}")


@pytest.mark.parametrize("env_id", ENV_IDS)
def test_state_continues_bit_equally_in_the_middle(env_id: str) -> None:
    spec = env_id.replace("-v0", "-LoRes3EA-v0")
    env, other = _make(spec), _make(spec)
    env.reset(seed=7)
    actions = np.random.default_rng(1).choice([1, 4, 7, 10, 13, 16], size=30).tolist()
    for action in actions[:20]:
        observation = env.step(action)[0]
    state = json.loads(json.dumps(env.get_state()))
    np.testing.assert_array_equal(other.set_state(state), observation)
    for action in actions[20:]:
        np.testing.assert_array_equal(env.step(action)[0], other.step(action)[0])
    np.testing.assert_array_equal(env.bodies, other.bodies)


@pytest.mark.parametrize("env_id", ENV_IDS)
def test_whole_episode_with_state_observation(env_id: str) -> None:
    env = _make(env_id, observation="state", reward="score")
    rng = np.random.default_rng(3)
    observation, info = env.reset(seed=11)
    assert info.pop("instruction").endswith(".")
    keys, steps, truncated = set(info), 0, False
    while not truncated:
        assert observation in env.observation_space
        observation, reward, terminated, truncated, info = env.step(int(rng.integers(18)))
        steps += 1
        assert set(info) == keys
        assert not terminated
    assert steps == env.horizon
    assert reward == info["eval_score"]
    assert info["is_success"] == (reward > SUCCESS)
    assert np.abs(env.bodies[:, :2]).max() < 1.0
