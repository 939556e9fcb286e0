"""The adapter for Stable-Baselines3."""

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

from magical.envs.vector import MagicalVectorEnv
from magical.errors import InvalidActionError, MissingDependencyError
from magical.scene import Pose
from magical.tasks import TASKS

sb3 = pytest.importorskip("stable_baselines3", reason="the extra sb3 is not installed")

HORIZON = 4
# Warnings of Stable-Baselines3 and PyTorch.
pytestmark = pytest.mark.filterwarnings("ignore")


@pytest.fixture(autouse=True)
def logs_in_the_tests_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SB3_LOGDIR", str(tmp_path))


def adapter(observation: Any = "state", num_envs: int = 2, workers: int = 0, **options: Any) -> Any:
    from magical.envs.sb3 import MagicalSB3VecEnv

    ids = ["magical/MoveToRegion-TestLayout-v0"] * num_envs
    options = {"horizon": HORIZON, "reward": "dense", "autoreset_mode": "SameStep", **options}
    return MagicalSB3VecEnv(
        MagicalVectorEnv(ids, workers=workers, observation=observation, **options)
    )


def test_episode_ends_follow_the_conventions_of_stable_baselines3() -> None:
    envs = adapter()
    plain = MagicalVectorEnv(
        envs.envs.env_ids,
        workers=0,
        observation="state",
        horizon=HORIZON,
        reward="dense",
        autoreset_mode="SameStep",
    )
    envs.seed(3)
    np.testing.assert_array_equal(envs.reset(), plain.reset(seed=3)[0])
    for step in range(2 * HORIZON):
        observations, rewards, ends, infos = envs.step(np.array([1, 4]))
        expected = plain.step([1, 4])
        np.testing.assert_array_equal(observations, expected[0])
        np.testing.assert_array_equal(rewards, expected[1].astype(np.float32))
        assert ends.tolist() == [step % HORIZON == HORIZON - 1] * 2
        for row in range(2):
            assert infos[row]["TimeLimit.truncated"] == ends[row]
            assert ("terminal_observation" in infos[row]) == ends[row]
    for row in range(2):
        final = expected[4]["final_obs"][row]
        np.testing.assert_array_equal(infos[row]["terminal_observation"], final)
        assert infos[row]["eval_score"] == expected[4]["final_info"]["eval_score"][row]
    assert infos[0] is not infos[1]


def test_the_scores_of_an_episode_are_in_its_last_info() -> None:
    envs, demo = adapter(), TASKS["MoveToRegion"].demo
    x, y = demo.regions[0].centre
    envs.set_options({"scene": replace(demo, robot=Pose(x, y, 0.0))})
    envs.reset()
    infos = [envs.step(np.zeros(2, int))[3][1] for _ in range(HORIZON)]
    scores = [(each["eval_score"], each["published_code_score"]) for each in infos]
    assert scores == [(0.0, 0.0)] * (HORIZON - 1) + [(1.0, 1.0)]
    assert [each["is_success"] for each in infos] == [False] * (HORIZON - 1) + [True]


def test_seeds_and_options_apply_to_one_reset() -> None:
    envs = adapter()
    envs.seed(3)
    first = envs.reset()
    assert np.any(envs.reset() != first)
    envs.seed(3)
    envs.set_options({"dynamics": {"body_pivot_max_force": 2.5}})
    np.testing.assert_array_equal(envs.reset(), first)
    forces = [state["dynamics"]["body_pivot_max_force"] for state in envs.env_method("get_state")]
    assert forces == [2.5, 2.5]
    envs.set_options([{}, {"dynamics": {}}])
    with pytest.raises(ValueError, match="the same for all environments"):
        envs.reset()


def test_attributes_and_methods() -> None:
    envs = adapter(workers=1)
    envs.reset()
    assert envs.metadata["render_fps"] == envs.envs.metadata["render_fps"] == 8
    assert envs.get_attr("env_ids", 1) == ["magical/MoveToRegion-TestLayout-v0"]
    assert envs.get_attr("workers") == [1, 1]
    assert envs.env_is_wrapped(gymnasium.Wrapper) == [False, False]
    assert envs.env_method("get_state", indices=[1]) == [envs.envs.get_state(1)]
    with pytest.raises(AttributeError, match="cannot be set"):
        envs.set_attr("horizon", 3)
    with pytest.raises(InvalidActionError):
        envs.step(np.array([0, 18]))
    envs.close()
    assert envs.envs.closed


def test_what_stable_baselines3_cannot_use_is_refused() -> None:
    with pytest.raises(ValueError, match="expects autoreset_mode='SameStep', found 'NextStep'"):
        adapter(autoreset_mode="NextStep")
    with pytest.raises(ValueError, match="expected copy=True"):
        adapter(copy=False)


@pytest.mark.parametrize("observation", ["LoRes4E", "LoResCHW4E", "LoResStack"])
def test_networks_get_channels_first(observation: str) -> None:
    envs = adapter(observation)
    policy = "MultiInputPolicy" if observation == "LoResStack" else "CnnPolicy"
    model = sb3.PPO(policy, envs, n_steps=HORIZON, batch_size=4, n_epochs=1, device="cpu", seed=0)
    space = model.observation_space
    shapes = [box.shape for box in space.values()] if observation == "LoResStack" else [space.shape]
    assert set(shapes) == {(12, 96, 96)}
    model.learn(2 * HORIZON)


@pytest.mark.parametrize("action_space", ["discrete", "continuous"])
def test_a_short_run_of_ppo_learns_from_states(action_space: str) -> None:
    envs = adapter(num_envs=4, workers=2, action_space=action_space)
    model = sb3.PPO("MlpPolicy", envs, n_steps=8, batch_size=16, n_epochs=2, device="cpu", seed=0)
    before = [parameter.detach().clone() for parameter in model.policy.parameters()]
    model.learn(128)
    assert model.num_timesteps == 128
    after = list(model.policy.parameters())
    assert any(bool((a != b).any()) for a, b in zip(after, before, strict=True))
    assert all(bool(a.isfinite().all()) for a in after)
    envs.close()


def test_without_the_library_the_message_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delitem(sys.modules, "magical.envs.sb3", raising=False)
    monkeypatch.setitem(sys.modules, "stable_baselines3", None)
    with pytest.raises(MissingDependencyError, match=r"pip install .*stable-baselines3"):
        import magical.envs.sb3  # noqa: F401
