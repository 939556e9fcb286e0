"""Ids of the published package, and what replaces its option."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import gymnasium
import pytest

import magical
from magical.envs.vector import MagicalVectorEnv
from magical.evaluation import published_tasks

PUBLISHED_IDS = [
    env_id.removeprefix("magical/")
    for env_id in magical.all_env_ids(presets=True)
    if env_id.task in published_tasks()
]


@pytest.fixture(autouse=True)
def registered(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gymnasium, "registry", registry := dict(gymnasium.registry))
    monkeypatch.setattr(gymnasium.envs.registration, "registry", registry)
    magical.register_published()


def test_importing_registers_sixty_environments_with_five_presets(tmp_path: Path) -> None:
    script = "import gymnasium; before = set(gymnasium.registry); import magical; "
    script += "print(*(set(gymnasium.registry) - before))"
    command = [sys.executable, "-c", script]
    printed = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert sorted(printed.stdout.split()) == sorted(f"magical/{name}" for name in PUBLISHED_IDS)
    assert len(PUBLISHED_IDS) == 360


def test_published_ids_make_the_environments_when_asked_for() -> None:
    for name in PUBLISHED_IDS:
        assert gymnasium.spec(name).kwargs == gymnasium.spec(f"magical/{name}").kwargs
    old: Any = gymnasium.make("ClusterColour-Demo-LoRes4E-v0", horizon=3).unwrapped
    new: Any = gymnasium.make("magical/ClusterColour-Demo-LoRes4E-v0").unwrapped
    assert (type(old), old.env_id, old.horizon) == (type(new), new.env_id, 3)
    assert old.observation_spec == new.observation_spec
    envs = gymnasium.make_vec("MakeLine-Demo-v0", 2, workers=0, observation="state")
    assert isinstance(envs, MagicalVectorEnv)
