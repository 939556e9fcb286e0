"""Frame stacks, kept in the array where they are shown."""

import numpy as np
from numpy.typing import NDArray

from magical.observe.spec import PixelSpec
from magical.render import Renderer, shift_stack
from magical.scene.scene import Scene

Pixels = NDArray[np.uint8]
PixelArrays = Pixels | dict[str, Pixels]


class PixelObserver:
    """Draws one world's pixel observation into an array it is given, or into one of its own.

    `table` is float64 (5 + blocks, 6): x, y, angle and their velocities in the rows of `Poses`.
    The array is the frame stack: `update` moves its frames one place towards the oldest and draws
    the newest.
    """

    def __init__(self, spec: PixelSpec, out: PixelArrays | None = None) -> None:
        self.spec = spec
        self.out = self.empty() if out is None else out
        self._stacks = self._frame_stacks()
        self._renderers: list[Renderer] = []

    def start(self, scene: Scene, table: NDArray[np.float64]) -> None:
        """Begin an episode: the first frame fills every place of the stack."""
        spec = self.spec
        self._renderers = [Renderer(scene, view, spec.size, spec.samples) for view, _ in spec.parts]
        for renderer, stack in zip(self._renderers, self._stacks, strict=True):
            renderer.draw(table, stack[:, :, -3:])
            for oldest in range(0, stack.shape[2] - 3, 3):
                stack[:, :, oldest : oldest + 3] = stack[:, :, -3:]

    def update(self, table: NDArray[np.float64]) -> None:
        """Show the next moment."""
        if isinstance(self.out, dict) or len(self._stacks) == 1:
            for renderer, stack in zip(self._renderers, self._stacks, strict=True):
                renderer.draw_stacked(table, stack)
            return
        # A whole array is moved quickly; what thereby crosses into another view is drawn over.
        shift_stack(self._channels_last(self.out))
        for renderer, stack in zip(self._renderers, self._stacks, strict=True):
            renderer.draw(table, stack[:, :, -3:])

    def copy(self) -> PixelArrays:
        """The observation, in memory of its own."""
        if isinstance(self.out, dict):
            return {view: array.copy() for view, array in self.out.items()}
        return self.out.copy()

    def empty(self) -> PixelArrays:
        """Arrays of the observation's shape, not yet drawn."""
        shape = self.spec.shape
        if self.spec.separate:
            return {str(view): np.empty(shape(n), np.uint8) for view, n in self.spec.parts}
        return np.empty(shape(sum(n for _, n in self.spec.parts)), np.uint8)

    def _frame_stacks(self) -> list[Pixels]:
        """One (size, size, 3 * frames) window on `out` for each view."""
        windows, first = [], 0
        for view, frames in self.spec.parts:
            array = self._channels_last(
                self.out[str(view)] if isinstance(self.out, dict) else self.out
            )
            if not self.spec.separate:
                array = array[:, :, first : first + 3 * frames]
            windows.append(array)
            first += 3 * frames
        return windows

    def _channels_last(self, array: Pixels) -> Pixels:
        return array.transpose(1, 2, 0) if self.spec.channels_first else array
