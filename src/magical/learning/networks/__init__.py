"""The network architectures, a file each; the file's name is the architecture's.

Such a file defines

- `HIDDEN`: the sizes of the linear layers that follow the convolutions, and
- `make_convolutions(channels, batch_norm)`: a module from images (B, channels, H, W), float in
  [0, 1] or [-1, 1], to feature maps of any shape (B, ...).

`magical.learning.models.Trunk` puts the two together and adds what all architectures share: the
action input of discriminators, and linear layers alone for state vectors.
"""

import importlib
import pkgutil
from typing import TYPE_CHECKING, Protocol, cast

from magical.errors import UnknownNameError

if TYPE_CHECKING:
    from torch import nn


class Architecture(Protocol):
    """What a file in this folder defines."""

    HIDDEN: tuple[int, ...]

    def make_convolutions(self, channels: int, batch_norm: bool) -> "nn.Module":
        """A module from images (B, channels, H, W) to feature maps (B, ...)."""


def network_names() -> tuple[str, ...]:
    """Every architecture, alphabetically; imports none."""
    names = (entry.name for entry in pkgutil.iter_modules(__path__))
    return tuple(sorted(name.replace("_", "-") for name in names))


def find_network(name: str) -> Architecture:
    """An architecture by name; raises `UnknownNameError`."""
    if name not in network_names():
        raise UnknownNameError(
            f"network {name!r} is unknown; expected one of: {', '.join(network_names())}"
        )
    return cast(Architecture, importlib.import_module(f"{__name__}.{name.replace('-', '_')}"))
