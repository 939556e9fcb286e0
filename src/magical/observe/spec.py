"""Observation specifications: the one interface to every kind of observation.

An `ObservationSpec` owns its Gymnasium space, the arrays that observations are stored in, how they
are made while an episode runs (`Observer`) and from a stored episode (`read`), and their network
input. Code outside this package need not know which kind of observation it has.
"""

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from magical.observe.arrays import ArrayFields
from magical.scene.scene import Scene
from magical.scene.vocabulary import View


class Observer(Protocol):
    """Keeps the current observation of one running episode in its array (or dict of arrays) `out`.

    `bodies` are float64 (5 + blocks, 6): x, y, angle and their velocities in the rows of `Poses`.
    """

    out: Any

    def start(self, scene: Scene, bodies: NDArray[np.float64]) -> None:
        """Start an episode."""

    def update(self, bodies: NDArray[np.float64]) -> None:
        """Observe the next step."""


class FrameSource(Protocol):
    """The frames of a stored episode in one view."""

    def render(self, time: int, out: NDArray[np.uint8]) -> None:
        """Write the frame of one step into `out` (size, size, 3), in any layout."""


class EpisodeSource(Protocol):
    """A stored episode of T steps, from which observations can be recomputed."""

    @property
    def scene(self) -> Scene:
        """The initial scene."""

    def __len__(self) -> int:
        """The number of actions T; step 0 is before the first."""

    def frames(self, view: View, size: int, samples: int | None) -> FrameSource:
        """Its frames in one view at one resolution."""

    def body_states(self) -> NDArray[np.float64]:
        """Poses and velocities of every body at every step, (T + 1, 5 + blocks, 6)."""


class Component(Protocol):
    """A part of an observation as a network gets it: an array per step, stacked `frames` deep."""

    @property
    def frames(self) -> int:
        """How many of the latest steps are stacked along the first axis."""

    def read(self, source: EpisodeSource, times: NDArray[np.intp]) -> NDArray[Any]:
        """The arrays of the steps `times` (B,): (B, channels, ...), not yet stacked."""


class ObservationSpec(Protocol):
    """One kind of observation, with all its settings."""

    @property
    def space(self) -> spaces.Space[Any]:
        """The Gymnasium space."""

    @property
    def fields(self) -> ArrayFields:
        """Shape and type of each array of one observation, by name."""

    @property
    def frames(self) -> int:
        """How many of the latest steps one observation depends on."""

    @property
    def num_images(self) -> int:
        """How many images are rendered for each step."""

    @property
    def network_shape(self) -> tuple[int, ...]:
        """The shape of one observation as a network gets it: (C, H, W), or (size,).

        Raises `ObservationError` for an observation that is not one array.
        """

    @property
    def components(self) -> Sequence[Component]:
        """What `network_input` consists of, in the order of its first axis."""

    def network_input(self, observations: Any) -> NDArray[Any]:
        """A batch of observations (B, ...) as a network gets it, (B, *network_shape); a view.

        Raises `ObservationError` for arrays of another shape or type.
        """

    def picture(self, observation: Any) -> NDArray[np.uint8] | None:
        """One observation as an RGB image (H, W, 3) to look at; `None` if it is not an image."""

    def observer(self, out: Any = None) -> Observer:
        """An observer that writes into `out`, or into new arrays."""

    def read(self, source: EpisodeSource, times: ArrayLike, out: Any = None) -> Any:
        """The observations of a stored episode at the steps `times` (B,), each 0 to T.

        Step 0 is what `reset` returned, t what the t-th `step` returned. Returns arrays of shape
        (B, *shape) as `fields` has them, written into `out` if it is given.
        """

    def to_dict(self) -> Any:
        """Plain data for JSON, from which `make_spec` makes the same specification again."""
