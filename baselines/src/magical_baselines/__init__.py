"""Learning: networks, augmentation, algorithms and their runs.

Importing this package does not import PyTorch, so commands can list algorithms without it: what
needs PyTorch is imported on first use.
"""

import importlib
from typing import TYPE_CHECKING, Any

from magical.runs import is_run
from magical_baselines.config import Algorithm, Config, algorithm_names, find_algorithm, read_config

if TYPE_CHECKING:
    from magical_baselines.policy import NetworkPolicy, TrainedPolicy, load_policy
    from magical_baselines.run import TrainResult, train

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

_NEEDS_TORCH = dict.fromkeys(("NetworkPolicy", "TrainedPolicy", "load_policy"), "policy")
_NEEDS_TORCH |= {"TrainResult": "run", "train": "run"}


def __getattr__(name: str) -> Any:
    if name not in _NEEDS_TORCH:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_NEEDS_TORCH[name]}"), name)
