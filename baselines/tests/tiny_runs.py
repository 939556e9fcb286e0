"""Shared by the tests of algorithms: the smallest runs, and comparisons of them."""

from typing import Any, TypeVar

import torch
from torch import Tensor

from magical.runs.folder import CHECKPOINT
from magical_baselines import Config
from magical_baselines.checkpoints import load_checkpoint
from magical_baselines.compute import Compute
from magical_baselines.config import options

AnyConfig = TypeVar("AnyConfig", bound=Config)
CPU = Compute("cpu", "float32")

# Settings of all algorithms, by option; each takes those that it has.
TINY: dict[str, Any] = {
    "tasks": ("MoveToRegion",),
    "demos": "",
    "num_demos": 2,
    "device": "cpu",
    "precision": "float32",
    "workers": 0,
    # behavioural cloning, in each round of DAgger
    "batches": 4,
    "batch_size": 4,
    "log_every": 2,
    "window": 3,
    "rounds": 2,
    "episodes": 1,
    # PPO, and what is built on it: three updates
    "num_envs": 3,
    "num_steps": 2,
    "epochs": 1,
    "minibatch_size": 3,
    "total_steps": 18,
    "evaluate_every": 0,
    "discriminator_steps": 1,
    "gradient_steps": 1,
    "buffer_size": 100,
    "discriminator_batch_size": 4,
    "pretraining_batches": 2,
    "pretraining_batch_size": 4,
    "feature_samples": 16,
}


def tiny(kind, preset="quick", **fields):
    """A configuration of a run of a fraction of a second."""
    own = {option.name for option in options(kind)}
    shared = {name: value for name, value in TINY.items() if name in own}
    return kind.preset(preset, **{**shared, **fields})


def checkpoint(folder):
    """The newest checkpoint."""
    return load_checkpoint(folder / CHECKPOINT)


def same_weights(first, second):
    """Whether the policies of two runs are equal, bit by bit."""
    a, b = (checkpoint(folder)["policy"] for folder in (first, second))
    return a.keys() == b.keys() and all(torch.equal(value, b[name]) for name, value in a.items())


def assert_same(first, second, name=""):
    """Equal nested state dicts, tensors bit by bit."""
    assert type(first) is type(second), name
    if isinstance(first, Tensor):
        assert torch.equal(first, second), name
    elif isinstance(first, dict):
        assert first.keys() == second.keys(), name
        for key, value in first.items():
            assert_same(value, second[key], f"{name}/{key}")
    elif isinstance(first, list):
        assert len(first) == len(second), name
        for index, pair in enumerate(zip(first, second, strict=True)):
            assert_same(*pair, f"{name}/{index}")
    else:
        assert first == second, name
