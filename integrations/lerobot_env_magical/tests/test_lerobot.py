"""The plug-in with LeRobot's own functions and its commands."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("lerobot", reason="LeRobot is not installed")

from lerobot.configs.types import FeatureType
from lerobot.envs.factory import make_env
from lerobot.envs.utils import add_envs_task, env_to_policy_features, preprocess_observation
from lerobot_env_magical import LeRobotMagicalEnv, MagicalEnvConfig
from lerobot_env_magical.export import export_lerobot

from magical.demos import Dataset, DatasetWriter
from magical.demos.generate import demonstrate
from magical.envs.seeds import evaluation_seed
from magical.errors import DatasetError, PolicyError
from magical.evaluation import evaluate, load_policy

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


@pytest.mark.parametrize("space", ["discrete", "continuous"])
def test_an_export_is_read_by_lerobot(tmp_path: Path, space: Any) -> None:
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    writer = DatasetWriter(tmp_path / "demos")
    for seed in range(2):
        writer.append(demonstrate("magical/MoveToRegion-TestJitter-v0", seed=seed, perturb=0.3))
    dataset = Dataset.open(tmp_path / "demos")
    total = export_lerobot(dataset, tmp_path / "exported", space)
    found = LeRobotDataset("local/magical", root=tmp_path / "exported")
    assert (len(found), found.num_episodes) == (total, 2) == (sum(map(len, dataset)), 2)
    first = dataset[0].with_action_space(space)
    env = LeRobotMagicalEnv("MoveToRegion-TestJitter-v0")
    observation, info = env.reset(seed=0)
    start, last = found[0], found[len(first) - 1]
    np.testing.assert_allclose(observation["agent_pos"], start["observation.state"], atol=1e-6)
    frame = (255 * start["observation.images.ego"].numpy()).transpose(1, 2, 0)
    assert np.abs(frame - observation["pixels"]["ego"]).mean() < 6
    assert start["task"] == info["instruction"]
    np.testing.assert_allclose(start["action"].numpy(), first.labels[0], atol=1e-6)
    np.testing.assert_allclose(start["executed_action"].numpy(), first.actions[0], atol=1e-6)
    assert (bool(last["next.done"]), float(last["next.reward"])) == (True, first.score)
    with pytest.raises(DatasetError, match="which exists"):
        export_lerobot(dataset, tmp_path / "exported")


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


@pytest.fixture(scope="module")
def policy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a small ACT, without training."""
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
        chunk_size=4,
        n_action_steps=2,
        use_vae=False,
        push_to_hub=False,
    )
    folder = tmp_path_factory.mktemp("act") / "policy"
    ACTPolicy(config).save_pretrained(folder)
    stats = {name: dict.fromkeys(("mean", "std", "min", "max"), np.ones(1)) for name in features}
    for processor in make_pre_post_processors(config, dataset_stats=stats):
        processor.save_pretrained(folder)
    return folder


def test_lerobots_command_and_ours_give_the_same_scores(policy: Path, tmp_path: Path) -> None:
    command = [
        *(sys.executable, "-m", "lerobot.scripts.lerobot_eval", f"--policy.path={policy}"),
        *("--env.discover_packages_path=lerobot_env_magical", "--env.type=magical"),
        *("--env.task=MatchRegions-TestAll-v0", "--eval.n_episodes=4", "--eval.batch_size=4"),
        *(f"--output_dir={tmp_path / 'out'}", "--policy.device=cpu"),
        f"--seed={evaluation_seed(0)}",
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    results = json.loads((tmp_path / "out" / "eval_info.json").read_text())
    assert results["overall"]["n_episodes"] == 4
    ours = evaluate(f"lerobot:{policy}", ["magical/MatchRegions-TestAll-v0"], rollouts=4)
    rewards = results["per_task"][0]["metrics"]["sum_rewards"]
    assert [row.score for row in ours] == pytest.approx(rewards)


def test_other_features_are_named(policy: Path, tmp_path: Path) -> None:
    config = json.loads((policy / "config.json").read_text())
    config["input_features"]["observation.state"]["shape"] = [7]
    config["input_features"]["observation.depth"] = {"type": "STATE", "shape": [2]}
    (tmp_path / "config.json").write_text(json.dumps(config))
    with pytest.raises(PolicyError, match=r"state \(7,\) \(expected \(5,\)\).*depth \(unknown\)"):
        load_policy(f"lerobot:{tmp_path}")
    with pytest.raises(PolicyError, match=r"expected a folder with LeRobot's config\.json"):
        load_policy(f"lerobot:{tmp_path / 'none'}")
