"""Pixel observations: stacks of rendered frames (docs/specification.md, section 7)."""

from contextlib import suppress
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector.utils import create_empty_array
from numpy.typing import ArrayLike, NDArray

from magical.errors import ObservationError
from magical.messages import quoted
from magical.observe.spec import EpisodeSource, ObservationSpec, checked, select, stack_indices
from magical.scene import Scene, View, chosen_samples, parse_word
from magical.scene.constants import FRAME_SIZE

if TYPE_CHECKING:
    from magical.render import Renderer

STACK = 4  # frames
MAX_FRAMES = 1000  # of a view in one observation
CHANNELS = 3  # of a frame: red, green, blue

Pixels = NDArray[np.uint8]


@dataclass(frozen=True)
class PixelSpec(ObservationSpec):
    """The last frames of one or two views, oldest first, uint8 RGB.

    Args:
        parts: the views in channel order, each with its number of frames. Before the first step
            the first frame is repeated.
        size: height and width in pixels.
        samples: as for `Renderer`.
        separate: a dict of views instead of one array (size, size, 3 * frames).
        channels_first: arrays (3 * frames, size, size).

    Raises:
        UnknownNameError: an unknown view.
        ObservationError: a view is missing or repeated, or its number of frames is out of range.
        RenderError: an invalid size or number of samples.
    """

    parts: tuple[tuple[View, int], ...] = ((View.EGO, STACK),)
    size: int = FRAME_SIZE
    samples: int | None = None
    separate: bool = False
    channels_first: bool = False

    def __post_init__(self) -> None:
        given: Any = self.parts
        parts: tuple[tuple[View, int], ...] = ()
        with suppress(TypeError):  # not pairs
            if all(len(part) == 2 for part in given):
                parts = tuple((parse_word(View, view), frames) for view, frames in given)
        object.__setattr__(self, "parts", parts)
        counts = [n for _, n in parts if isinstance(n, int) and 0 < n <= MAX_FRAMES]
        if not 0 < len(counts) == len(parts) == len(dict(parts)):
            raise ObservationError(
                f"parts: expected each view once, with 1 to {MAX_FRAMES} frames, "
                f"found {quoted(given)}"
            )
        chosen_samples(self.size, self.samples)

    @property
    def space(self) -> spaces.Space[Any]:
        if self.separate:
            return spaces.Dict({str(view): self._box(frames) for view, frames in self.parts})
        return self._box(self._stacked)

    def _box(self, frames: int) -> spaces.Box:
        size, channels = self.size, CHANNELS * frames
        shape = (channels, size, size) if self.channels_first else (size, size, channels)
        return spaces.Box(0, 255, shape, np.uint8)

    @property
    def _stacked(self) -> int:
        return sum(frames for _, frames in self.parts)

    @property
    def num_images(self) -> int:
        return len(self.parts)

    @property
    def network_shape(self) -> tuple[int, ...]:
        if self.separate:
            raise ObservationError(
                "observation: expected one array of images, found a dict of views; use a preset "
                "with one array"
            )
        return CHANNELS * self._stacked, self.size, self.size

    @property
    def components(self) -> "tuple[tuple[PixelSpec, int], ...]":
        return tuple(
            (PixelSpec(((view, 1),), self.size, self.samples, channels_first=True), frames)
            for view, frames in self.parts
        )

    def network_input(self, observations: Any) -> NDArray[Any]:
        shape, images = self.network_shape, np.asarray(observations)
        if not self.channels_first and images.ndim == 4:
            images = images.transpose(0, 3, 1, 2)
        return checked(images, shape, np.uint8)

    def stacks(self, observation: Any) -> list[Pixels]:
        """An array view (..., size, size, 3 * frames) of each camera's frames, for any batch."""
        windows, first = [], 0
        for view, frames in self.parts:
            array = observation[view] if self.separate else observation
            if self.channels_first:
                array = np.moveaxis(array, -3, -1)
            if not self.separate:
                array = array[..., first : first + CHANNELS * frames]
                first += CHANNELS * frames
            windows.append(array)
        return windows

    def observer(self, out: Any = None) -> "PixelObserver":
        return PixelObserver(self, out)

    def read(self, source: EpisodeSource, times: ArrayLike) -> Any:
        steps = np.asarray(times, np.intp)
        out = create_empty_array(self.space, len(steps), np.empty)
        for (view, frames), window in zip(self.parts, self.stacks(out), strict=True):
            rendered = source.frames(view, self.size, self.samples)
            first: dict[int, Pixels] = {}  # where each frame appears first
            for stack, indices in zip(window, stack_indices(steps, frames).tolist(), strict=True):
                for frame, time in zip(np.split(stack, frames, axis=-1), indices, strict=True):
                    if time in first:
                        copy_pixels(first[time], frame)
                    else:
                        rendered.render(time, frame)
                        first[time] = frame
        return out

    def to_dict(self) -> dict[str, Any]:
        return asdict(self)


class PixelObserver:
    """Renders a running episode's frames into its observation, which is the frame stack itself.

    `update` shifts the frames by one towards the oldest and renders the newest.
    """

    def __init__(self, spec: PixelSpec, out: Any) -> None:
        self.spec = spec
        self.out = select(create_empty_array(spec.space), 0) if out is None else out
        self._stacks = spec.stacks(self.out)
        self._renderers: list[Renderer] = []

    def start(self, scene: Scene, bodies: NDArray[np.float64]) -> None:
        """Start an episode: the first frame fills the whole stack."""
        from magical.render import Renderer  # imports numba: only when something is rendered

        spec = self.spec
        self._renderers = [Renderer(scene, view, spec.size, spec.samples) for view, _ in spec.parts]
        for renderer, stack in zip(self._renderers, self._stacks, strict=True):
            newest = stack[:, :, -CHANNELS:]
            renderer.render(bodies, newest)
            for first in range(0, stack.shape[2] - CHANNELS, CHANNELS):
                copy_pixels(newest, stack[:, :, first : first + CHANNELS])

    def update(self, bodies: NDArray[np.float64]) -> None:
        """Observe the next step."""
        if self.spec.separate or len(self._stacks) == 1:
            for renderer, stack in zip(self._renderers, self._stacks, strict=True):
                renderer.render_stacked(bodies, stack)
            return
        from magical.render import shift_stack

        # Shifting the whole array at once is fast; what crosses into another view is overwritten.
        shift_stack(np.moveaxis(self.out, 0, -1) if self.spec.channels_first else self.out)
        for renderer, stack in zip(self._renderers, self._stacks, strict=True):
            renderer.render(bodies, stack[:, :, -CHANNELS:])


def copy_pixels(source: Pixels, out: Pixels) -> None:
    """Copy an image channel by channel: NumPy takes three times as long pixel by pixel."""
    for channel in range(CHANNELS):
        out[..., channel] = source[..., channel]
