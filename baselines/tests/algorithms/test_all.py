"""All algorithms: presets train, resume and are evaluated; settings matter or are refused."""

from contextlib import contextmanager
from functools import cache
from typing import Any

import numpy as np
import pytest

from baselines.tests.conftest import TASKS
from baselines.tests.tiny_runs import assert_same, checkpoint, same_weights, tiny
from magical.errors import MagicalError
from magical.evaluation import evaluate
from magical.runs.sources import SOURCES
from magical_baselines import algorithm_names, find_algorithm, train
from magical_baselines.config import DemonstrationConfig, options
from magical_baselines.training import Purpose

# Settings of each algorithm with other values than those of the smallest run: each has to change
# the weights. Those that several algorithms share are tried in the first that has them.
CHANGES: dict[str, dict[str, Any]] = {
    "bc": {
        "num_demos": 3,
        "seed": 1,
        "conventions": "published",
        "precision": "bfloat16",
        "optimizer": "sgd",
        "learning_rate": 2e-3,
        "momentum": 0.5,
        "anneal": False,
        "augment": "noise",
    },
    "act": {"chunk": 4, "action_space": "continuous"},
    "transformer-bc": {"window": 4, "past_actions": False},
    "dagger": {"episodes": 2, "variants": ("Layout",), "beta_decay": 1.0},
    "gail": {
        "conventions": "published",
        "reward_std": 0.5,
        "augment": "none",
        "discriminator_learning_rate": 1e-2,
        "discriminator_steps": 3,
    },
    "iq-learn": {
        "buffer_size": 18,
        "gradient_steps": 2,
        "anneal": False,
        "gamma": 0.5,
        "temperature": 0.5,
        "chi2_scale": 1.0,
        "target_every": 1,
    },
    "wgail-gp": {"penalty_weight": 1.0},
    "al": {"feature_samples": 5, "pretraining_learning_rate": 1e-2, "augment": "noise"},
    "ppo": {
        "init": "torch",
        "epochs": 2,
        "clip_range": 1e-3,
        "ent_coef": 1.0,
        "gamma": 0.5,
        "gae_lambda": 0.5,
        "max_grad_norm": 1e-3,
        "normalise_advantages": False,
        "bootstrap": False,
    },
}
ONE_TASK = ("al", "wgail-gp", "dagger")  # the last for its episodes
# Of the presets' runs, whose networks are large.
SHORTER = {
    "batches": 2,
    "num_envs": 2,
    "minibatch_size": 2,
    "total_steps": 8,
    "pretraining_batch_size": 2,
    "feature_samples": 4,
}
NAMES = [  # other distributions test their own
    name
    for name in algorithm_names()
    if find_algorithm(name).config.__module__.startswith("magical_baselines.")
]
PRESETS = [(name, preset) for name in NAMES for preset in find_algorithm(name).config.presets]


def kind_of(algorithm):
    return find_algorithm(algorithm).config


def demos_of(algorithm, demos):
    return {"demos": str(demos)} if issubclass(kind_of(algorithm), DemonstrationConfig) else {}


@contextmanager
def no_random_stream_used_twice():
    """But for that of demonstrations, which are chosen alike for all tasks."""
    seeds: list[Any] = []
    default_rng = np.random.default_rng

    def noted(seed=None):
        seeds.append(seed)
        return default_rng(seed)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(np.random, "default_rng", noted)
        yield
    streams = [s for s in seeds if isinstance(s, tuple) and isinstance(s[1], Purpose)]
    used = [s for s in streams if s[1] is not Purpose.DEMONSTRATIONS]
    assert len(set(used)) == len(used) > 1


@pytest.mark.parametrize(("algorithm", "preset"), PRESETS)
def test_every_preset_trains_resumes_bit_equal_and_is_evaluated(algorithm, preset, demos, tmp_path):
    """The settings that it has, but for the sizes of batches and of the run."""
    one = algorithm in ONE_TASK or preset == "states"  # whose length depends on the task
    tasks = TASKS[1:] if one else TASKS
    own = {option.name for option in options(kind_of(algorithm))}
    lengths = {name: value for name, value in SHORTER.items() if name in own}
    given = {**demos_of(algorithm, demos), **lengths, "tasks": tasks}
    if algorithm not in ("bc", "gail", "ppo"):  # in which the larger networks are tried
        given["network"] = "narrow"
    config = tiny(kind_of(algorithm), preset, **given)
    with no_random_stream_used_twice():
        assert train(config, tmp_path / "whole").finished
    assert train(config, tmp_path / "parts", stop_after=1).step == 1
    trained = train(config, tmp_path / "parts", resume=True)
    assert trained.finished
    whole, parts = (checkpoint(tmp_path / name) for name in ("whole", "parts"))
    # DAgger's episodes are compared in its own tests: their files hold the time of recording.
    assert_same({**whole, "aggregate": None}, {**parts, "aggregate": None})
    evaluate(trained.policy(), ["magical/MoveToRegion-Demo-v0"], rollouts=1, workers=0, horizon=2)


def smallest(algorithm, demos, **fields):
    given = {"tasks": TASKS[1:], **demos_of(algorithm, demos), **fields}
    return tiny(kind_of(algorithm), **given)


@pytest.fixture(scope="module")
def plain(demos, tmp_path_factory):
    """The folder of an algorithm's smallest run."""

    @cache
    def run(algorithm):
        folder = tmp_path_factory.mktemp("plain") / "run"
        train(smallest(algorithm, demos), folder)
        return folder

    return run


@pytest.mark.parametrize(
    ("algorithm", "name"),
    [(algorithm, name) for algorithm in CHANGES for name in CHANGES[algorithm]],
)
def test_every_setting_changes_what_is_learned(algorithm, name, demos, tmp_path, plain):
    changed = smallest(algorithm, demos, **{name: CHANGES[algorithm][name]})
    train(changed, tmp_path / "run")
    assert not same_weights(tmp_path / "run", plain(algorithm))


@pytest.mark.parametrize(
    ("algorithm", "fields", "message"),
    [
        ("bc", {"observation": "state"}, "augment: expected none"),
        ("bc", {"observation": "state", "augment": "none", "tasks": TASKS}, "one task is expected"),
        ("act", {"chunk": 5, "execute": 6}, "execute: expected at most the 5 actions"),
        ("diffusion", {"denoising_steps": 101}, "denoising_steps: expected at most the 100"),
        ("dagger", {"beta_decay": 1.5}, "beta_decay: expected float <= 1.0"),
        ("dagger", {"variants": ()}, "variants: expected at least one"),
        ("dagger", {"variants": ("Demo", "Jitter")}, "episodes: expected at least one for each of"),
        ("dagger", {"variants": ("Fog",)}, "'Fog' is not a variant"),
        ("dagger", {"variants": ("Shape",)}, "MoveToRegion has none of the variants"),
        (
            "ppo",
            {"total_steps": 5, "num_envs": 2, "num_steps": 3},
            "total_steps: expected at least",
        ),
        ("ppo", {"num_envs": 1, "tasks": TASKS}, "num_envs"),
        ("ppo", {"observation": "state", "tasks": TASKS}, "state vectors differ between tasks"),
        ("ppo", {"reward": "none"}, "reward 'none' is unknown; expected one of: score, dense"),
        ("ppo", {"normalise_advantages": True, "num_envs": 1, "num_steps": 1}, "at least 2"),
        ("gail", {"discriminator_batch_size": 5}, "discriminator_batch_size: expected an even"),
        ("gail", {"discriminator_batch_size": 2, "tasks": TASKS}, "discriminator_batch_size"),
        ("gail", {"horizon": "published"}, "one horizon only"),
        ("wgail-gp", {"tasks": TASKS}, "wgail-gp: expected one task"),
        ("al", {"tasks": TASKS}, "al: expected one task"),
        ("iq-learn", {"batch_size": 2, "tasks": TASKS}, "batch_size"),
        ("iq-learn", {"buffer_size": 17}, "buffer_size: expected at least 18 frames for 3"),
    ],
)
def test_settings_that_cannot_be_combined_are_refused(algorithm, fields, message):
    with pytest.raises(MagicalError, match=message):
        tiny(kind_of(algorithm), **fields)


DEMONSTRATED = ("demonstrations",)


@pytest.mark.parametrize(
    ("algorithm", "expected"),
    [
        *((name, DEMONSTRATED) for name in ("act", "bc", "diffusion", "transformer-bc")),
        *((name, (*DEMONSTRATED, "interaction")) for name in ("al", "gail", "iq-learn")),
        ("wgail-gp", (*DEMONSTRATED, "interaction")),
        ("ppo", ("interaction", "score")),
        ("dagger", (*DEMONSTRATED, "interaction", "expert labels")),
    ],
)
def test_an_entry_says_what_was_learned_from(algorithm, expected):
    demonstrated = {"num_demos": 7} if "demonstrations" in expected else {}
    details = tiny(kind_of(algorithm), "paper", seed=3, **demonstrated).training_details
    assert (details["algorithm"], details["training_seed"]) == (algorithm, 3)
    assert tuple(details["learned_from"]) == expected
    assert set(expected) <= set(SOURCES)
    assert details.get("demonstrations") == (
        "7 of each task" if "demonstrations" in expected else None
    )
