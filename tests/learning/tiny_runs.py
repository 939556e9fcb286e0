"""Shared by the tests of PPO and what is built on it: minimal runs, comparisons."""

from pathlib import Path
from typing import Any, TypeVar

import torch
from torch import Tensor

from magical.learning.algorithms.ppo import ReinforcementConfig
from magical.learning.running.checkpoints import load_checkpoint
from magical.runs.folder import CHECKPOINT

AnyConfig = TypeVar("AnyConfig", bound=ReinforcementConfig)


def tiny(kind: type[AnyConfig], preset: str = "quick", **fields: Any) -> AnyConfig:
    """A configuration whose updates take a fraction of a second: three of them, by default."""
    settings = {
        "tasks": ("MoveToRegion",),
        "num_envs": 3,
        "num_steps": 2,
        "epochs": 1,
        "minibatch_size": 3,
        "total_steps": 18,
        "workers": 0,
        "evaluate_every": 0,
        "device": "cpu",
        "precision": "float32",
    }
    return kind.preset(preset, **{**settings, **fields})


def checkpoint(folder: Path) -> dict[str, Any]:
    """The newest checkpoint."""
    return load_checkpoint(folder / CHECKPOINT)


def assert_same(first: Any, second: Any, name: str = "") -> None:
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
