"""Every preset of every algorithm runs, and every setting changes what is learned."""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from baselines.tests.conftest import TASKS
from baselines.tests.tiny_runs import assert_same, checkpoint, same_weights, tiny
from magical.evaluation import evaluate
from magical_baselines import Config, algorithm_names, find_algorithm, train
from magical_baselines.algorithms import al
from magical_baselines.config import options
from magical_baselines.running.streams import Purpose
from magical_goals import object_bc

# Settings with other values than those of the smallest run: each has to change the weights.
CLONING: dict[str, Any] = {
    "num_demos": 3,
    "observation": "LoRes4A",
    "seed": 1,
    "network": "light",
    "conventions": "published",
    "precision": "bfloat16",
    "batches": 5,
    "batch_size": 5,
    "optimizer": "sgd",
    "learning_rate": 2e-3,
    "momentum": 0.5,
    "anneal": False,
    "augment": "noise",
    "tasks": ("MoveToCorner",),
}
CHANGES: dict[str, dict[str, Any]] = {
    "bc": CLONING,
    "act": {
        "num_demos": 3,
        "observation": "LoRes4A",
        "seed": 1,
        "network": "light",
        "precision": "bfloat16",
        "batches": 5,
        "batch_size": 5,
        "learning_rate": 2e-3,
        "weight_decay": 0.1,
        "augment": "noise",
        "tasks": ("MoveToCorner",),
        "chunk": 4,
        "action_space": "continuous",
        "kl_weight": 1.0,
    },
    "diffusion": {"chunk": 8, "batch_size": 5, "precision": "bfloat16"},
    "transformer-bc": {"window": 4, "past_actions": False, "precision": "bfloat16"},
    "dagger": {
        "rounds": 3,
        "batches": 1,
        "episodes": 2,
        "variants": ("Layout",),
        "beta_decay": 1.0,
    },
    "object-bc": {
        "seed": 1,
        "num_demos": 1,
        "batch_size": 9,
        "learning_rate": 1e-3,
        "mirror": False,
        "block_range": 3.0,
        "wall_range": 2.0,
        "drop_blocks": 1.0,
    },
    "gail": {
        "conventions": "published",
        "ent_coef": 1.0,
        "reward_std": 0.5,
        "augment": "none",
        "discriminator_learning_rate": 1e-2,
        "discriminator_steps": 3,
    },
    "iq-learn": {
        "seed": 1,
        "num_demos": 3,
        "network": "light",
        "conventions": "published",
        "num_envs": 4,
        "num_steps": 3,
        "buffer_size": 18,
        "gradient_steps": 2,
        "batch_size": 6,
        "learning_rate": 1e-3,
        "anneal": False,
        "gamma": 0.5,
        "temperature": 0.5,
        "chi2_scale": 1.0,
        "target_every": 1,
        "augment": "none",
    },
    "wgail-gp": {"conventions": "published", "penalty_weight": 1.0},
    "al": {
        "autoencoder": "appendix",
        "weight_metric": "euclidean",
        "feature_samples": 5,
        "pretraining_learning_rate": 1e-2,
        "augment": "noise",
        "reward_std": 0.5,
    },
}
CHANGES["ppo"] = {
    "reward": "score",
    "init": "torch",
    "epochs": 2,
    "minibatch_size": 2,
    "learning_rate": 1e-3,
    "clip_range": 1e-3,
    "anneal": False,
    "gamma": 0.5,
    "gae_lambda": 0.5,
    "max_grad_norm": 1e-3,
    "normalise_advantages": False,
    "bootstrap": False,
}
CHANGES["program-bc"] = {"num_demos": 1}  # all others are those of object-bc
OF_OBJECTS = ("object-bc", "program-bc")
# Those of objects for their demonstrations, the last for its episodes.
ONE_TASK = ("al", "wgail-gp", *OF_OBJECTS, "dagger")
# Of the presets' runs, whose networks are large.
SHORTER = {
    "batches": 2,
    "num_envs": 2,
    "minibatch_size": 2,
    "total_steps": 8,
    "pretraining_batch_size": 2,
    "feature_samples": 4,
}
PRESETS = [
    (name, preset) for name in algorithm_names() for preset in find_algorithm(name).config.presets
]


def kind_of(algorithm: str) -> type[Config]:
    return find_algorithm(algorithm).config


@pytest.fixture(scope="module")
def data(demos: Path, expert_demos: Path) -> Any:
    """Demonstrations of an algorithm: pictures, or such as have objects."""
    return lambda algorithm: str(expert_demos if algorithm in OF_OBJECTS else demos)


@pytest.fixture(autouse=True)
def few_batches_that_no_setting_says(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(al, "STATISTICS_BATCHES", 2)
    monkeypatch.setattr(object_bc, "GOAL_EVERY", 2)
    monkeypatch.setattr(object_bc, "GOAL_BATCH_SIZE", 4)


@contextmanager
def no_random_stream_used_twice() -> Iterator[None]:
    """But for that of demonstrations, which are chosen alike for all tasks."""
    seeds: list[Any] = []
    default_rng = np.random.default_rng

    def noted(seed: Any = None) -> np.random.Generator:
        seeds.append(seed)
        return default_rng(seed)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(np.random, "default_rng", noted)
        yield
    streams = [s for s in seeds if isinstance(s, tuple) and isinstance(s[1], Purpose)]
    used = [s for s in streams if s[1] is not Purpose.DEMONSTRATIONS]
    assert len(set(used)) == len(used) > 1


@pytest.mark.parametrize(("algorithm", "preset"), PRESETS)
def test_every_preset_trains_resumes_bit_equal_and_is_evaluated(
    algorithm: str, preset: str, data: Any, tmp_path: Path
) -> None:
    """The networks and settings that it has, but for the sizes of batches and of the run."""
    demos = {} if algorithm == "ppo" else {"demos": data(algorithm)}
    one = algorithm in ONE_TASK or preset == "states"  # whose length depends on the task
    tasks = TASKS[1:] if one else TASKS
    own = {option.name for option in options(kind_of(algorithm))}
    lengths = {name: value for name, value in SHORTER.items() if name in own}
    config = tiny(kind_of(algorithm), preset, **demos, **lengths, tasks=tasks)
    with no_random_stream_used_twice():
        assert train(config, tmp_path / "whole").finished
    assert train(config, tmp_path / "parts", stop_after=1).step == 1
    trained = train(config, tmp_path / "parts", resume=True)
    assert trained.finished
    whole, parts = (checkpoint(tmp_path / name) for name in ("whole", "parts"))
    # DAgger's episodes are compared in its own tests: their files hold the time of recording.
    assert_same({**whole, "aggregate": None}, {**parts, "aggregate": None})
    ids = ["magical/MoveToRegion-Demo-v0"]
    assert len(evaluate(trained.policy(), ids, rollouts=1, workers=0, horizon=2)) == 1


@pytest.fixture(scope="module")
def plain(data: Any, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """The folder of an algorithm's smallest run."""

    @cache
    def run(algorithm: str) -> Path:
        folder = tmp_path_factory.mktemp("plain") / "run"
        train(smallest(algorithm, data(algorithm)), folder)
        return folder

    return run


def smallest(algorithm: str, demos: str, **fields: Any) -> Config:
    tasks = ("MoveToRegion", "FixColour") if algorithm in OF_OBJECTS else TASKS[1:]
    demonstrations = {} if algorithm == "ppo" else {"demos": demos}
    return tiny(kind_of(algorithm), **{"tasks": tasks, **demonstrations, **fields})


@pytest.mark.parametrize(
    ("algorithm", "name"),
    [(algorithm, name) for algorithm in CHANGES for name in CHANGES[algorithm]],
)
def test_every_setting_changes_what_is_learned(
    algorithm: str, name: str, data: Any, tmp_path: Path, plain: Any
) -> None:
    changed = smallest(algorithm, data(algorithm), **{name: CHANGES[algorithm][name]})
    train(changed, tmp_path / "run")
    assert not same_weights(tmp_path / "run", plain(algorithm))
