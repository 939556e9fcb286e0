"""The network architectures, one per file; the file's name is the architecture's.

Each file defines `NETWORK`, an `Architecture`. Other distributions provide an object or a module
like it through entry points of the group `magical.networks`. Any other is named by `module:NAME`.
One that was made from more than a run's data has `LEARNED_FROM`, terms of `magical.runs.sources`.

`magical_baselines.models.Trunk` puts the parts together and adds what all architectures share: the
action input of discriminators, and linear layers only for state vectors.
"""

from typing import TYPE_CHECKING, Protocol, runtime_checkable

from magical.plugins import Registry, is_plugin

if TYPE_CHECKING:
    from torch import nn

GROUP = "magical.networks"  # of entry points


@runtime_checkable
class Architecture(Protocol):
    """Convolutions and the sizes of the linear layers that follow."""

    @property
    def HIDDEN(self) -> tuple[int, ...]:
        """The sizes of the linear layers."""

    def make_convolutions(self, channels: int, batch_norm: bool) -> "nn.Module":
        """A module from float images (B, channels, H, W) to feature maps (B, ...)."""


_NETWORKS: Registry[Architecture] = Registry(
    "network",
    Architecture,  # type: ignore[type-abstract]
    GROUP,
)


def find_network(name: str) -> Architecture:
    """An architecture by its name or `module:NAME`; raises `UnknownNameError`, `PluginError`."""
    return _NETWORKS.get(name)


def sources_of(name: str) -> tuple[str, ...]:
    """What an architecture was made from beside a run's data; raises what `find_network` does."""
    stated = getattr(find_network(name), "LEARNED_FROM", ()) if is_plugin(GROUP, name) else ()
    return tuple(stated)
