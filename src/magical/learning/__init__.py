"""Learning: networks, augmentation, algorithms and their runs.

Importing this package does not import PyTorch, so commands can list algorithms without it.
Whatever needs PyTorch is imported on first use; if PyTorch is missing, this raises
`MissingDependencyError` with the command that installs it.
"""

import importlib
from typing import TYPE_CHECKING, Any

from magical.extras import require
from magical.learning.algorithms import Algorithm, algorithm_names, find_algorithm, read_config
from magical.learning.config import Config
from magical.runs import is_run

if TYPE_CHECKING:
    from magical.learning.policy import NetworkPolicy, TrainedPolicy, load_policy
    from magical.learning.running.training import TrainResult, train

__all__ = [
    "Algorithm",
    "Config",
    "NetworkPolicy",
    "TrainResult",
    "TrainedPolicy",
    "algorithm_names",
    "find_algorithm",
    "is_run",
    "load_policy",
    "read_config",
    "train",
]

_NEEDS_TORCH = {
    "NetworkPolicy": "policy",
    "TrainedPolicy": "policy",
    "load_policy": "policy",
    "TrainResult": "running.training",
    "train": "running.training",
}


def __getattr__(name: str) -> Any:
    if name not in _NEEDS_TORCH:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    require("learning")
    return getattr(importlib.import_module(f"{__name__}.{_NEEDS_TORCH[name]}"), name)
