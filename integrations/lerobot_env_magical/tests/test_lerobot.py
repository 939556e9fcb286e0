"""The plug-in with LeRobot's own functions and its commands."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lerobot.configs.types import FeatureType
from lerobot.envs.factory import make_env
from lerobot.envs.utils import add_envs_task, env_to_policy_features, preprocess_observation
from lerobot_env_magical import MagicalEnvConfig

HUB = Path(__file__).resolve().parents[1] / "hub" / "env.py"


@pytest.fixture
def envs() -> Any:
    made = make_env(MagicalEnvConfig(task="MoveToCorner-TestColour-v0"), n_envs=2)
    envs = made["magical"][0]
    yield envs
    envs.close()


def test_observations_become_the_features_of_the_policy(envs: Any) -> None:
    features = env_to_policy_features(MagicalEnvConfig())
    observation, _ = envs.reset(seed=[1, 2])
    found = preprocess_observation(observation)
    assert {name: tuple(value.shape[1:]) for name, value in found.items()} == {
        name: feature.shape
        for name, feature in features.items()
        if feature.type is not FeatureType.ACTION
    }
    assert features["action"].shape == envs.single_action_space.shape
    tasks = add_envs_task(envs, found)["task"]
    assert len(tasks) == 2
    assert all("corner" in task for task in tasks)


def test_the_last_step_tells_success_and_score(envs: Any) -> None:
    envs.reset(seed=[1, 2])
    for _ in range(envs.call("_max_episode_steps")[0]):
        _, rewards, _, truncated, infos = envs.step(np.zeros((2, 3), np.float32))
    assert truncated.all()
    assert infos["final_info"]["is_success"].tolist() == [False, False]
    assert infos["final_info"]["eval_score"].tolist() == rewards.tolist()


def test_the_hub_file_makes_every_variant() -> None:
    from lerobot.envs.utils import _call_make_env, _import_hub_module, _normalize_hub_result

    module = _import_hub_module(str(HUB), "someone/magical")
    made = _normalize_hub_result(_call_make_env(module, 1, False, None))
    assert "Demo" in made
    assert "TestAll" in made
    for suite in made.values():
        observation, _ = suite[0].reset(seed=0)
        assert observation["pixels"]["allo"].shape == (1, 96, 96, 3)
        suite[0].close()


def test_a_policy_is_evaluated_by_lerobots_command(tmp_path: Path) -> None:
    from lerobot.configs.types import PolicyFeature
    from lerobot.policies.act.configuration_act import ACTConfig
    from lerobot.policies.act.modeling_act import ACTPolicy
    from lerobot.policies.factory import make_pre_post_processors

    features = env_to_policy_features(MagicalEnvConfig())
    split: dict[bool, dict[str, PolicyFeature]] = {True: {}, False: {}}
    for name, feature in features.items():
        split[feature.type is FeatureType.ACTION][name] = feature
    config = ACTConfig(
        input_features=split[False],
        output_features=split[True],
        pretrained_backbone_weights=None,
        device="cpu",
        dim_model=32,
        dim_feedforward=32,
        n_heads=2,
        use_vae=False,
        push_to_hub=False,
    )
    policy = tmp_path / "policy"
    ACTPolicy(config).save_pretrained(policy)
    stats = {name: dict.fromkeys(("mean", "std", "min", "max"), np.ones(1)) for name in features}
    for processor in make_pre_post_processors(config, dataset_stats=stats):
        processor.save_pretrained(policy)
    command = [
        *(sys.executable, "-m", "lerobot.scripts.lerobot_eval", f"--policy.path={policy}"),
        *("--env.discover_packages_path=lerobot_env_magical", "--env.type=magical"),
        *("--env.task=MoveToCorner-TestJitter-v0", "--eval.n_episodes=2", "--eval.batch_size=2"),
        *(f"--output_dir={tmp_path / 'out'}", "--policy.device=cpu"),
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    results = json.loads((tmp_path / "out" / "eval_info.json").read_text())
    assert results["overall"]["n_episodes"] == 2
    assert 0 <= results["overall"]["avg_sum_reward"] <= 1
