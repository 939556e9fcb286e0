"""The algorithms, a file each; the file's name is the algorithm's (`_` for `-`).

Such a file has a configuration class, `train(config, run)`, `make_policy(config)` and at its end
`ALGORITHM = Algorithm(...)`.
"""

import importlib
import pkgutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from magical.errors import UnknownNameError
from magical.extras import require
from magical.learning.config import Config
from magical.runs.folder import CONFIG, read_json

if TYPE_CHECKING:
    from torch import nn

    from magical.learning.running.run import Run


@dataclass(frozen=True, slots=True)
class Algorithm:
    """What a file of this folder offers.

    Attributes:
        config: the configuration class.
        train: called as `train(config, run)`; trains, logs, and saves checkpoints whose entry
            `policy` is the state dict of
        make_policy: a function from the configuration to a module that maps observations (B, ...)
            and tasks (B,) to logits (B, 18).
    """

    config: type[Config]
    train: "Callable[[Any, Run], None]"
    make_policy: "Callable[[Any], nn.Module]"

    @property
    def name(self) -> str:
        """For instance `bc` or `wgail-gp`."""
        return self.config.algorithm


def algorithm_names() -> list[str]:
    """Every algorithm, alphabetically; imports none."""
    found = (entry.name for entry in pkgutil.iter_modules(__path__))
    return sorted(name.replace("_", "-") for name in found if not name.startswith("_"))


def find_algorithm(name: str) -> Algorithm:
    """An algorithm by name.

    Raises:
        UnknownNameError: there is none of this name.
        MissingDependencyError: PyTorch is not installed.
    """
    if name not in algorithm_names():
        raise UnknownNameError(
            f"algorithm {name!r} is unknown; expected one of: {', '.join(algorithm_names())}"
        )
    require("learning")
    module = importlib.import_module(f"{__name__}.{name.replace('-', '_')}")
    algorithm: Algorithm = module.ALGORITHM
    return algorithm


def read_config(folder: Path) -> Config:
    """The configuration recorded in a run folder."""
    data = read_json(folder / CONFIG)
    return find_algorithm(str(data.get("algorithm"))).config.from_dict(data)
