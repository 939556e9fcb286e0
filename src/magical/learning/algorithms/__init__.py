"""The algorithms, a file each; the file's name is the algorithm's (`_` for `-`).

Such a file has a configuration class, `train(config, run)`, `make_policy(config)` and at its end
`ALGORITHM = Algorithm(...)`. Those of other distributions are found by entry points of the group
`magical.algorithms`, and any other by `module:NAME`.
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
    """What a file of this folder offers.

    Attributes:
        config: the configuration class.
        train: called as `train(config, run)`; trains, logs, and saves checkpoints whose entry
            `policy` is the state dict of the module that `make_policy` returns.
        make_policy: a function from the configuration to a module that maps observations (B, ...)
            and tasks (B,) to logits (B, 18), or to what `policy` takes.
        policy: the kind of policy that acts by this module; `None` for `NetworkPolicy`.
    """

    config: type[Config]
    train: "Callable[[Any, Run], None]"
    make_policy: "Callable[[Any], nn.Module]"
    policy: "type[TrainedPolicy] | None" = None


_ALGORITHMS = Registry("algorithm", Algorithm, "magical.algorithms", __name__, "ALGORITHM")


def algorithm_names() -> list[str]:
    """Every algorithm, of this and of other distributions, alphabetically; imports none."""
    return _ALGORITHMS.names()


def find_algorithm(name: str) -> Algorithm:
    """An algorithm by name, or by `module:NAME`.

    Raises:
        UnknownNameError: there is none of this name.
        PluginError: it is another distribution's and cannot be imported.
        MissingDependencyError: PyTorch is not installed.
    """
    if ":" in name or name in algorithm_names():
        require("learning")
    return _ALGORITHMS.get(name)


def read_config(folder: Path | str) -> Config:
    """The configuration recorded in a run folder.

    It may name modules of others, which are not imported from the working folder on its word.

    Raises:
        RunFolderError: the record is missing, damaged, or names an algorithm or a module that is
            not installed.
        InvalidConfigError: its settings cannot be.
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
