"""Observation specifications: the one interface to every kind of observation.

Code outside this package need not know which kind of observation it has: one array, or a dict of
arrays by name.
"""

from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from magical.errors import ObservationError
from magical.scene import Scene, View


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

    def frames(self, view: View, size: int, samples: int | None) -> FrameSource:
        """Its frames in one view at one resolution."""

    def body_states(self) -> NDArray[np.float64]:
        """Poses and velocities of every body at every step, (T + 1, 5 + blocks, 6)."""


class ObservationSpec(Protocol):
    """One kind of observation, with all its settings."""

    @property
    def space(self) -> spaces.Space[Any]:
        """The Gymnasium space."""

    @property
    def frames(self) -> int:
        """How many of the latest steps one observation depends on."""
        return max(frames for _, frames in self.components)

    @property
    def num_images(self) -> int:
        """How many images are rendered for each step."""

    @property
    def network_shape(self) -> tuple[int, ...]:
        """The shape of one observation as a network gets it: (C, H, W), or (size,).

        Raises `ObservationError` for an observation that is not one array.
        """

    @property
    def components(self) -> "Sequence[tuple[ObservationSpec, int]]":
        """What `network_input` consists of, in the order of its first axis.

        Each is what is observed in a single step, channels first, and how many of these are
        stacked along the first axis.
        """

    def network_input(self, observations: Any) -> NDArray[Any]:
        """A batch of observations (B, ...) as a network gets it, (B, *network_shape); a view.

        Raises `ObservationError` for arrays of another shape or type.
        """

    def observer(self, out: Any = None) -> Observer:
        """An observer that writes into `out`, or into new arrays."""

    def read(self, source: EpisodeSource, times: ArrayLike) -> Any:
        """The observations (B, ...) of a stored episode at the steps `times` (B,), each 0 to T.

        Step 0 is what `reset` returned, t what the t-th `step` returned.
        """

    def to_dict(self) -> Any:
        """Plain data for JSON, from which `make_spec` makes the same specification again."""


def map_arrays(function: Callable[..., Any], observation: Any, *others: Any) -> Any:
    """Apply a function to the arrays of observations: one each, or those of a name in dicts."""
    if isinstance(observation, dict):
        return {k: function(array, *(o[k] for o in others)) for k, array in observation.items()}
    return function(observation, *others)


def select(observations: Any, rows: Any) -> Any:
    """Some rows of a batch of observations: a view for an integer or a slice, not a copy."""
    return map_arrays(lambda array: array[rows], observations)


def copy_arrays(observation: Any) -> Any:
    """A copy of the observation."""
    return map_arrays(lambda array: array.copy(), observation)


def checked(inputs: NDArray[Any], shape: tuple[int, ...], dtype: Any) -> NDArray[Any]:
    """A network's input (B, *shape); raises `ObservationError` if it is another."""
    if inputs.dtype != dtype or inputs.shape[1:] != shape:
        raise ObservationError(
            f"observations: expected {np.dtype(dtype)} of shape (B, {', '.join(map(str, shape))}) "
            f"for the network, found {inputs.dtype} of shape {inputs.shape}; make the environments "
            "with the observation that the policy was trained on"
        )
    return inputs


def stack_indices(times: ArrayLike, frames: int) -> NDArray[np.intp]:
    """The times of the frames in stacks that end at `times`: (B, frames), oldest first.

    Before the first step the first frame is repeated (docs/specification.md, section 7).
    """
    newest = np.asarray(times, np.intp)[:, None]
    indices: NDArray[np.intp] = np.maximum(newest + np.arange(1 - frames, 1), 0)
    return indices
