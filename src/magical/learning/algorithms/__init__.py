"""The algorithms, one per file, named after the algorithm (with `_` for `-`).

Each file has a configuration class, `train(config, run)`, `make_policy(config)` and, at its end,
`ALGORITHM = Algorithm(...)`. Algorithms of other distributions are found through the entry-point
group `magical.algorithms`, and any other by `module:NAME`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from magical.errors import RunFolderError, UnknownNameError
from magical.extras import require
from magical.learning.config import Config
from magical.learning.networks import TIMM
from magical.plugins import Registry, require_known_module
from magical.runs.folder import CONFIG, is_run, read_json

if TYPE_CHECKING:
    from torch import nn

    from magical.learning.policy import TrainedPolicy
    from magical.learning.running.run import Run


@dataclass(frozen=True, slots=True)
class Algorithm:
    """What the file of an algorithm provides.

    Attributes:
        config: the configuration class.
        train: called as `train(config, run)`; trains, logs, and saves checkpoints whose entry
            `policy` is the state dict of the module that `make_policy` returns.
        make_policy: a function from the configuration to a module that maps observations (B, ...)
            and tasks (B,) to logits (B, 18), or to whatever `policy` expects.
        policy: the class of the policy that acts with this module; `None` for `NetworkPolicy`.
    """

    config: type[Config]
    train: "Callable[[Any, Run], None]"
    make_policy: "Callable[[Any], nn.Module]"
    policy: "type[TrainedPolicy] | None" = None


_ALGORITHMS = Registry("algorithm", Algorithm, "magical.algorithms", __name__, "ALGORITHM")


def algorithm_names() -> list[str]:
    """The names of all algorithms, including other distributions', sorted; imports none."""
    return _ALGORITHMS.names()


def find_algorithm(name: str) -> Algorithm:
    """An algorithm by name, or by `module:NAME`.

    Raises:
        UnknownNameError: there is no algorithm of this name.
        PluginError: the algorithm is a plugin that cannot be imported, or is not an `Algorithm`.
        MissingDependencyError: PyTorch is not installed.
    """
    if ":" in name or name in algorithm_names():
        require("learning")
    return _ALGORITHMS.get(name)


def read_config(folder: Path | str) -> Config:
    """The configuration recorded in a run folder.

    The record may name third-party modules, which are only imported if they are installed or the
    user has already imported them.

    Raises:
        RunFolderError: the record is missing, damaged, or names an unknown algorithm.
        PluginError: the record names a module that is not installed.
        MissingDependencyError: PyTorch is not installed.
        InvalidConfigError: the settings are invalid.
    """
    path = Path(folder) / CONFIG
    if not is_run(folder):
        raise RunFolderError(f"{folder}: expected a run folder with {CONFIG}, found none")
    data = read_json(path)
    names = {key: data.get(key) for key in ("algorithm", "network", "observation", "perception")}
    for key, name in names.items():
        if key == "algorithm" and not isinstance(name, str):
            raise RunFolderError(f"{path}: expected the name of an algorithm, found none")
        if isinstance(name, str) and not (key == "network" and name.startswith(TIMM)):
            require_known_module(name, str(path))
    try:
        kind = find_algorithm(str(names["algorithm"])).config
    except UnknownNameError as error:
        raise RunFolderError(f"{path}: {error}") from error
    return kind.from_dict(data, str(path))
