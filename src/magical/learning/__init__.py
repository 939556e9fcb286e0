"""Learning: networks, augmentations, the algorithms and their runs. Needs PyTorch."""

import importlib.util

from magical.errors import MissingDependencyError

for _name in ("torch", "safetensors"):
    if importlib.util.find_spec(_name) is None:
        raise MissingDependencyError(
            f"learning needs {_name}, which is not installed; pip install "
            '"magical-benchmark[learning]"'
        )

from magical.learning.algorithms import Algorithm, algorithm_names, find_algorithm  # noqa: E402
from magical.learning.config import Config  # noqa: E402
from magical.learning.policy import NetworkPolicy, is_run, load_policy  # noqa: E402
from magical.learning.training import Trained, train  # noqa: E402

__all__ = [
    "Algorithm",
    "Config",
    "NetworkPolicy",
    "Trained",
    "algorithm_names",
    "find_algorithm",
    "is_run",
    "load_policy",
    "train",
]
