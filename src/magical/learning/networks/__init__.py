"""The network architectures, a file each; the file's name is the architecture's.

Such a file defines

- `HIDDEN`: the sizes of the linear layers that follow the convolutions, and
- `make_convolutions(channels, batch_norm)`: a module from images (B, channels, H, W), float in
  [0, 1] or [-1, 1], to feature maps of any shape (B, ...).

Other distributions offer a module or an object with these two by entry points of the group
`magical.networks`, and any other is named by `module:NAME`. `magical.learning.models.Trunk` puts
the two together and adds what all architectures share: the action input of discriminators, and
linear layers alone for state vectors.
"""

from typing import TYPE_CHECKING, Protocol, runtime_checkable

from magical.plugins import Registry

if TYPE_CHECKING:
    from torch import nn


@runtime_checkable
class Architecture(Protocol):
    """What a file in this folder defines."""

    HIDDEN: tuple[int, ...]

    def make_convolutions(self, channels: int, batch_norm: bool) -> "nn.Module":
        """A module from images (B, channels, H, W) to feature maps (B, ...)."""


_NETWORKS: Registry[Architecture] = Registry(
    "network",
    Architecture,  # type: ignore[type-abstract]
    "magical.networks",
    __name__,
)


def network_names() -> tuple[str, ...]:
    """Every architecture, of this and of other distributions, alphabetically; imports none."""
    return tuple(_NETWORKS.names())


def find_network(name: str) -> Architecture:
    """An architecture by name, or by `module:NAME`.

    Raises:
        UnknownNameError: there is none of this name.
        PluginError: it is another distribution's and cannot be imported.
    """
    return _NETWORKS.get(name)
