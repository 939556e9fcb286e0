"""Ids of environments, ours and the published package's, and the seeds of episodes."""

import hashlib
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

import magical
from magical.envs.env import MagicalEnv
from magical.envs.seeds import (
    FIRST_EVALUATION_SEED,
    episode_seed,
    evaluation_seed,
    sample_training_seeds,
)
from magical.envs.vector import MagicalVectorEnv
from magical.evaluation import published_tasks
from magical.tasks import get_task

PUBLISHED_IDS = [
    env_id.removeprefix("magical/")
    for env_id in magical.all_env_ids(presets=True)
    if env_id.task in published_tasks()
]


def test_importing_registers_sixty_environments_with_five_presets(tmp_path: Path) -> None:
    script = "import gymnasium; before = set(gymnasium.registry); import magical; "
    script += "print(*(set(gymnasium.registry) - before))"
    command = [sys.executable, "-c", script]
    printed = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert sorted(printed.stdout.split()) == sorted(f"magical/{name}" for name in PUBLISHED_IDS)
    assert len(PUBLISHED_IDS) == 360


def test_published_ids_make_the_environments_when_asked_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(gymnasium, "registry", registry := dict(gymnasium.registry))
    monkeypatch.setattr(gymnasium.envs.registration, "registry", registry)
    magical.register_published()
    for name in PUBLISHED_IDS:
        assert gymnasium.spec(name).kwargs == gymnasium.spec(f"magical/{name}").kwargs
    old: Any = gymnasium.make("ClusterColour-Demo-LoRes4E-v0", horizon=3).unwrapped
    new: Any = gymnasium.make("magical/ClusterColour-Demo-LoRes4E-v0").unwrapped
    assert (type(old), old.env_id, old.horizon) == (type(new), new.env_id, 3)
    assert old.observation_spec == new.observation_spec
    envs = gymnasium.make_vec("MakeLine-Demo-v0", 2, workers=0, observation="state")
    assert isinstance(envs, MagicalVectorEnv)


# SHA-256 of the start of each variant's first rollout, in millionths of units and radians.
FIRST_STARTS = {
    "MoveToCorner": "a59785d7e9e2",
    "MoveToRegion": "6e966c703fa4",
    "MatchRegions": "67654ba56521",
    "MakeLine": "b52984325f9d",
    "FindDupe": "3afc83583225",
    "FixColour": "4efd475e0e6f",
    "ClusterColour": "9f809f32356d",
    "ClusterShape": "12e3357004c8",
}


@pytest.mark.parametrize(("task", "expected"), FIRST_STARTS.items())
def test_a_seed_stands_for_the_same_start_in_all_versions(task: str, expected: str) -> None:
    """Otherwise scores of earlier versions are of other scenes."""
    digest = hashlib.sha256()
    for variant in get_task(task).variants:
        env = MagicalEnv(task, variant, observation="state")
        env.reset(seed=evaluation_seed(0))
        state = env.get_state()
        start = json.dumps([state["scene"], state["dynamics"], state["horizon"]])
        rounded = json.loads(start, parse_float=lambda text: round(1e6 * float(text)))
        digest.update(json.dumps(rounded).encode())
    assert digest.hexdigest()[:12] == expected


def test_demonstrations_and_training_stay_below_evaluation() -> None:
    assert [episode_seed(3, episode) for episode in range(3)] == [811504540, 978228692, 844359529]
    demos = {episode_seed(seed, episode) for seed in range(20) for episode in range(200)}
    assert len(demos) == 4000
    training = sample_training_seeds(np.random.default_rng(0), 4000)
    assert max(demos | set(training)) < FIRST_EVALUATION_SEED <= evaluation_seed(0)
