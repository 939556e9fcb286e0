"""The algorithms, one per file, named after the algorithm (with `_` for `-`).

Each file has a configuration class, `train(config, run)`, `make_policy(config)` and, at its end,
`ALGORITHM = Algorithm(...)`. Algorithms are found through the entry-point group
`magical.algorithms`, those of this distribution as well, and any other by `module:NAME`.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from magical.errors import RunFolderError, UnknownNameError
from magical.plugins import Registry, require_imported
from magical.runs.folder import CONFIG, is_run, read_json
from magical_baselines.config import Config, options

if TYPE_CHECKING:
    from torch import nn

    from magical_baselines.policy import TrainedPolicy
    from magical_baselines.running.run import Run


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


_ALGORITHMS = Registry("algorithm", Algorithm, "magical.algorithms")


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
    return _ALGORITHMS.get(name)


def read_config(folder: Path | str, given: Mapping[str, Any] = MappingProxyType({})) -> Config:
    """The configuration recorded in a run folder.

    Args:
        folder: the run folder.
        given: settings by option name that the user has named, too; their modules are imported.

    Raises:
        RunFolderError: the record is missing, damaged, or names an unknown algorithm.
        PluginError: the record names an object of a module that the user has not imported.
        MissingDependencyError: PyTorch is not installed.
        InvalidConfigError: the settings are invalid.
    """
    path = Path(folder) / CONFIG
    if not is_run(folder):
        raise RunFolderError(f"{folder}: expected a run folder with {CONFIG}, found none")
    data = read_json(path)
    algorithm = data.get("algorithm")
    if not isinstance(algorithm, str):
        raise RunFolderError(f"{path}: expected the name of an algorithm, found none")
    require_imported(algorithm, str(path))
    try:
        kind = find_algorithm(algorithm).config
    except UnknownNameError as error:
        raise RunFolderError(f"{path}: {error}") from error
    for name in references(kind, data):
        if name not in given.values():
            require_imported(name, str(path))
    return kind.from_dict(data, str(path))


def references(kind: type[Config], settings: Mapping[str, Any]) -> list[str]:
    """The `module:NAME` among the settings of a configuration class, by option name."""
    values = (settings.get(option.name) for option in options(kind) if option.open)
    return [value for value in values if isinstance(value, str) and ":" in value]


def modules_of(config: Config) -> list[str]:
    """What `--import` must name before another process may read the run of a configuration."""
    names = [config.algorithm, *references(type(config), config.to_dict())]
    return list(dict.fromkeys(name.rpartition(":")[0] for name in names if ":" in name))
