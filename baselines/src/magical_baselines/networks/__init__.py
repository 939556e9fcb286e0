"""The network architectures, one per file; the file's name is the architecture's.

Each file defines `NETWORK`, which has

- `HIDDEN`: the sizes of the linear layers that follow the convolutions, and
- `make_convolutions(channels, batch_norm)`: a module from images (B, channels, H, W), float in
  [0, 1] or [-1, 1], to feature maps of any shape (B, ...).

Other distributions provide an object or a module with these two through entry points of the group
`magical.networks`. Any other is named by `module:NAME`. One that was made from more than a run's
data has `LEARNED_FROM`, terms of `magical.runs.sources` that the run's entries state, such as those
of `magical_goals.objects.parser`.

`magical_baselines.models.Trunk` puts the parts together and adds what all architectures share: the
action input of discriminators, and linear layers only for state vectors.
"""

from typing import TYPE_CHECKING, Protocol, runtime_checkable

from magical.plugins import Registry, is_plugin

if TYPE_CHECKING:
    from torch import nn


@runtime_checkable
class Architecture(Protocol):
    """An architecture, of which each file in this folder defines one."""

    @property
    def HIDDEN(self) -> tuple[int, ...]:
        """The sizes of the linear layers."""

    def make_convolutions(self, channels: int, batch_norm: bool) -> "nn.Module":
        """A module from images (B, channels, H, W) to feature maps (B, ...)."""


GROUP = "magical.networks"  # of entry points

_NETWORKS: Registry[Architecture] = Registry(
    "network",
    Architecture,  # type: ignore[type-abstract]
    GROUP,
)


def network_names() -> tuple[str, ...]:
    """The sorted names of all architectures, of this and other distributions; imports none."""
    return tuple(_NETWORKS.names())


def find_network(name: str) -> Architecture:
    """Find an architecture by its name or by `module:NAME`.

    Raises:
        UnknownNameError: there is no architecture with this name.
        PluginError: it belongs to another distribution and cannot be imported.
    """
    return _NETWORKS.get(name)


def sources_of(name: str) -> tuple[str, ...]:
    """What an architecture was made from, beside a run's data, in the terms of `runs.sources`.

    Its `LEARNED_FROM`. Raises what `find_network` raises.
    """
    if not is_plugin(GROUP, name):
        return ()
    stated: tuple[str, ...] = getattr(find_network(name), "LEARNED_FROM", ())
    return stated
