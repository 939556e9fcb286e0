"""One interface for pixel and state-vector observations."""

from typing import Any, Protocol

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from magical.observe.spec import PixelSpec
from magical.observe.vector import StateLayout, StateObserver
from magical.scene.scene import Scene


class Observer(Protocol):
    """Shows one world's episode, moment by moment, in its array (or dict of arrays) `out`."""

    out: Any

    def start(self, scene: Scene, table: NDArray[np.float64]) -> None:
        """Begin an episode; `table` (5 + blocks, 6): x, y, angle and their velocities."""

    def update(self, table: NDArray[np.float64]) -> None:
        """Show the next moment."""

    def copy(self) -> Any:
        """What `out` holds, in memory of its own."""


def make_observer(form: PixelSpec | StateLayout, out: Any = None) -> Observer:
    """An observer of the given form that writes into `out`, or into arrays of its own."""
    if isinstance(form, StateLayout):
        return StateObserver(form, out)
    from magical.observe.pixels import PixelObserver  # drawing brings in numba: only when needed

    return PixelObserver(form, out)


def observation_space(form: PixelSpec | StateLayout) -> spaces.Space[Any]:
    """The Gymnasium space of an observation form."""
    return form.space


def frames_shown(form: PixelSpec | StateLayout) -> int:
    """How many of the latest moments one observation shows."""
    return 1 if isinstance(form, StateLayout) else max(frames for _, frames in form.parts)
