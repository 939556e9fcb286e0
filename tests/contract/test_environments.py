"""The interface of every registered environment."""

import json
import subprocess
import sys
import warnings
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import magical
from magical.envs.env import MagicalEnv
from magical.observe import PRESETS
from magical.scene import to_continuous
from magical.tasks import TASKS
from magical.tasks.scoring import SUCCESS

ENV_IDS = magical.all_env_ids()
ALL_IDS = magical.all_env_ids(presets=True)
# What a preset changes does not depend on the variant.
CHECKED_IDS = [env_id for env_id in ALL_IDS if env_id in ENV_IDS or env_id.variant == "Demo"]


def _make(env_id: str, **options: Any) -> MagicalEnv:
    env = gym.make(env_id, **options).unwrapped
    assert isinstance(env, MagicalEnv)
    return env


def _equal(first: Any, second: Any) -> bool:
    if isinstance(first, dict):
        return first.keys() == second.keys() and all(_equal(first[k], second[k]) for k in first)
    return first.dtype == second.dtype and np.array_equal(first, second)


def test_every_variant_is_registered_with_every_preset() -> None:
    assert len(ENV_IDS) == sum(len(task.variants) for task in TASKS.values())
    assert len(ALL_IDS) == len(ENV_IDS) * (1 + len(PRESETS))
    assert all(env_id in gym.registry for env_id in ALL_IDS)


@pytest.mark.parametrize("env_id", CHECKED_IDS)
def test_gymnasium_s_checker_reports_nothing(env_id: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(gym.make(env_id, render_mode="rgb_array").unwrapped, skip_render_check=False)


@pytest.mark.parametrize("env_id", [env_id for env_id in ENV_IDS if env_id.variant == "Demo"])
def test_discrete_actions_are_points_of_the_continuous_ones(env_id: str) -> None:
    envs = [_make(env_id, observation="state", action_space=a) for a in ("discrete", "continuous")]
    for env in envs:
        env.reset(seed=5)
    order = np.random.default_rng(0).permutation(np.tile(np.arange(18), 2))
    for action, point in zip(order.tolist(), to_continuous(order), strict=True):
        bodies = [env.step(given)[0] for env, given in zip(envs, (action, point), strict=True)]
        assert _equal(*bodies), action
        first, second = (env.state() for env in envs)
        np.testing.assert_array_equal(first.poses.bodies, second.poses.bodies)
        np.testing.assert_array_equal(first.velocities, second.velocities)


@pytest.mark.parametrize("env_id", ENV_IDS)
def test_same_seed_and_actions_same_bits(env_id: str) -> None:
    spec = env_id.replace("-v0", "-LoResStack-v0")
    actions = np.random.default_rng(0).integers(18, size=12).tolist()
    runs = []
    for _ in range(2):
        env = gym.make(spec)
        history = [env.reset(seed=5)[0]]
        history += [env.step(action)[0] for action in actions]
        runs.append(history)
    assert all(_equal(a, b) for a, b in zip(*runs, strict=True))


@pytest.mark.parametrize("env_id", ENV_IDS)
def test_state_continues_bit_equally_in_the_middle(env_id: str) -> None:
    spec = env_id.replace("-v0", "-LoRes3EA-v0")
    env, other = _make(spec), _make(spec)
    env.reset(seed=7)
    actions = np.random.default_rng(1).choice([1, 4, 7, 10, 13, 16], size=30).tolist()
    for action in actions[:20]:
        observation = env.step(action)[0]
    state = json.loads(json.dumps(env.get_state()))
    assert _equal(other.set_state(state), observation)
    for action in actions[20:]:
        assert _equal(env.step(action)[0], other.step(action)[0])
    assert np.array_equal(env.state().poses.bodies, other.state().poses.bodies)


_OTHER_PROCESS = """
import hashlib, json, sys, gymnasium as gym, magical
env = gym.make(sys.argv[1]).unwrapped
digest = hashlib.sha256(env.set_state(json.loads(sys.stdin.read())).tobytes())
for action in (1, 13, 13, 4, 10):
    digest.update(env.step(action)[0].tobytes())
print(digest.hexdigest())
"""


def test_state_continues_in_another_process() -> None:
    import hashlib

    env_id = "magical/ClusterShape-TestAll-LoRes4E-v0"
    env = _make(env_id)
    env.reset(seed=2)
    for action in (1, 1, 1, 10, 13, 16, 1, 1):
        observation = env.step(action)[0]
    result = subprocess.run(
        [sys.executable, "-c", _OTHER_PROCESS, env_id],
        input=json.dumps(env.get_state()), capture_output=True, text=True, check=True,
    )  # fmt: skip
    digest = hashlib.sha256(observation.tobytes())
    for action in (1, 13, 13, 4, 10):
        digest.update(env.step(action)[0].tobytes())
    assert result.stdout.strip() == digest.hexdigest()


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
    assert 0.0 <= info["eval_score"] <= 1.0
    assert 0.0 <= info["published_code_score"] <= 1.0
    positions = env.state().poses.bodies[:, :2]
    assert np.abs(positions).max() < 1.0
