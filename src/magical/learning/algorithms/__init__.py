"""The algorithms, a file each; the file's name is the algorithm's (`_` reads `-`).

Such a file has a configuration class, `train(config, run)`, `make_policy(config)` and at its end
`ALGORITHM = Algorithm(...)`.
"""

import importlib
import pkgutil
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from magical.errors import UnknownNameError

if TYPE_CHECKING:
    from torch import nn

    from magical.learning.config import Config
    from magical.learning.runs import Run


@dataclass(frozen=True, slots=True)
class Algorithm:
    """One way to learn a policy.

    `train(config, run)` learns, logs and leaves checkpoints whose key `policy` holds the weights of
    what `make_policy(config)` returns: a module `(observations, tasks) -> logits`.
    """

    config: "type[Config]"
    train: "Callable[[Any, Run], None]"
    make_policy: "Callable[[Any], nn.Module]"

    @property
    def name(self) -> str:
        """For instance `bc` or `wgail-gp`."""
        return self.config.algorithm


def algorithm_names() -> list[str]:
    """Every algorithm, alphabetically; nothing is imported for it."""
    found = (entry.name for entry in pkgutil.iter_modules(__path__))
    return sorted(name.replace("_", "-") for name in found if not name.startswith("_"))


def find_algorithm(name: str) -> Algorithm:
    """An algorithm by name; raises `UnknownNameError`."""
    if name not in algorithm_names():
        raise UnknownNameError(
            f"algorithm {name!r} is unknown; expected one of: {', '.join(algorithm_names())}"
        )
    module = importlib.import_module(f"{__name__}.{name.replace('-', '_')}")
    algorithm: Algorithm = module.ALGORITHM
    return algorithm
