"""Pixel observations: stacks of rendered frames.

Source: appendix A.1; docs/specification.md, section 7.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from magical.errors import ObservationError, UnknownNameError
from magical.messages import quoted
from magical.observe.arrays import SINGLE, ArrayFields, empty, stack_indices
from magical.observe.spec import EpisodeSource, FrameSource
from magical.scene.constants import FRAME_SIZE, MAX_FRAME_SIZE, MAX_SAMPLES_ACROSS, SAMPLES
from magical.scene.scene import Scene
from magical.scene.vocabulary import View, parse_word

if TYPE_CHECKING:
    from magical.render import Renderer

STACK = 4  # frames
MAX_FRAMES = 1000  # of a view in one observation
CHANNELS = 3  # of a frame: red, green, blue

Pixels = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class PixelSpec:
    """The last frames of one or two views, oldest first, uint8 RGB.

    Args:
        parts: the views in channel order, each with its number of frames.
        size: height and width in pixels.
        samples: 1, 2 or 4; samples x samples are averaged in each pixel, at most 4096 across a
            frame; `None` takes the fewest that make at least 384 across, at most 4, as in the
            published pipeline.
        separate: a dict of views instead of one array (size, size, 3 * frames).
        channels_first: arrays (3 * frames, size, size).

    Before the first step the first frame is repeated. Raises `ObservationError` for invalid
    settings, `UnknownNameError` for an unknown view.
    """

    parts: tuple[tuple[View, int], ...] = ((View.EGO, STACK),)
    size: int = FRAME_SIZE
    samples: int | None = None
    separate: bool = False
    channels_first: bool = False

    def __post_init__(self) -> None:
        try:
            parts = tuple(
                (parse_word(View, view), _whole("frames", frames, MAX_FRAMES))
                for view, frames in self.parts
            )
        except (UnknownNameError, ObservationError):
            raise
        except (TypeError, ValueError):  # not pairs
            parts = ()
        if not 0 < len(parts) == len({view for view, _ in parts}):
            raise ObservationError(
                f"parts: expected each view once, with its frames, found {quoted(self.parts)}"
            )
        object.__setattr__(self, "parts", parts)
        object.__setattr__(self, "size", _whole("size", self.size, MAX_FRAME_SIZE))
        if self.samples is not None:
            object.__setattr__(self, "samples", _whole("samples", self.samples, max(SAMPLES)))
            if self.samples not in SAMPLES:
                raise ObservationError(f"samples: expected one of {SAMPLES}, found {self.samples}")
            if self.size * self.samples > MAX_SAMPLES_ACROSS:
                raise ObservationError(
                    f"size and samples: expected at most {MAX_SAMPLES_ACROSS} samples across a "
                    f"frame, found {self.size} x {self.samples}; use fewer samples"
                )

    def shape(self, frames: int) -> tuple[int, int, int]:
        """The shape of an array of `frames` stacked frames."""
        channels = CHANNELS * frames
        if self.channels_first:
            return channels, self.size, self.size
        return self.size, self.size, channels

    @property
    def fields(self) -> ArrayFields:
        if self.separate:
            return {str(view): (self.shape(frames), np.uint8) for view, frames in self.parts}
        return {SINGLE: (self.shape(self._stacked), np.uint8)}

    @property
    def space(self) -> spaces.Space[Any]:
        boxes: dict[str, spaces.Space[Any]] = {
            name: spaces.Box(0, 255, shape, np.uint8) for name, (shape, _) in self.fields.items()
        }
        return spaces.Dict(boxes) if self.separate else boxes[SINGLE]

    @property
    def frames(self) -> int:
        return max(frames for _, frames in self.parts)

    @property
    def num_images(self) -> int:
        return len(self.parts)

    @property
    def network_shape(self) -> tuple[int, ...]:
        """(3 * frames, size, size)."""
        if self.separate:
            raise ObservationError(
                "observation: expected one array of images, found a dict of views; use a preset "
                "with one array"
            )
        return CHANNELS * self._stacked, self.size, self.size

    @property
    def components(self) -> "tuple[ViewComponent, ...]":
        return tuple(
            ViewComponent(view, frames, self.size, self.samples) for view, frames in self.parts
        )

    @property
    def _stacked(self) -> int:
        return sum(frames for _, frames in self.parts)

    def network_input(self, observations: Any) -> NDArray[Any]:
        """Images (B, C, H, W) uint8 that share the observations' memory."""
        _ = self.network_shape  # raises for a dict of views
        expected = self.shape(self._stacked)
        array = np.asarray(observations)
        if array.dtype != np.uint8 or array.shape[1:] != expected:
            raise ObservationError(
                f"observations: expected uint8 of shape (B, {', '.join(map(str, expected))}), "
                f"found {array.dtype} of shape {array.shape}; make the environments with the "
                "observation that the policy was trained on"
            )
        return array if self.channels_first else array.transpose(0, 3, 1, 2)

    def stacks(self, observation: Any) -> list[Pixels]:
        """An array view (..., size, size, 3 * frames) of each camera's frames, for any batch."""
        windows, first = [], 0
        for view, frames in self.parts:
            array = observation[str(view)] if self.separate else observation
            if self.channels_first:
                array = np.moveaxis(array, -3, -1)
            if not self.separate:
                array = array[..., first : first + CHANNELS * frames]
                first += CHANNELS * frames
            windows.append(array)
        return windows

    def picture(self, observation: Any) -> Pixels:
        """All frames side by side, by view, oldest first."""
        stacks = self.stacks(observation)
        frames = [np.split(stack, stack.shape[-1] // CHANNELS, axis=-1) for stack in stacks]
        return np.concatenate([frame for stack in frames for frame in stack], axis=1)

    def observer(self, out: Any = None) -> "PixelObserver":
        return PixelObserver(self, out)

    def read(self, source: EpisodeSource, times: ArrayLike, out: Any = None) -> Any:
        steps = np.asarray(times, np.intp)
        out = empty(self.fields, steps.shape) if out is None else out
        for (view, frames), window in zip(self.parts, self.stacks(out), strict=True):
            rendered = source.frames(view, self.size, self.samples)
            _render_stacks(rendered, stack_indices(steps, frames), window)
        return out

    def to_dict(self) -> dict[str, Any]:
        return asdict(self)


@dataclass(frozen=True, slots=True)
class ViewComponent:
    """One view's frames, channels first."""

    view: View
    frames: int
    size: int
    samples: int | None

    def read(self, source: EpisodeSource, times: NDArray[np.intp]) -> Pixels:
        """See `Component`: (B, 3, size, size) uint8."""
        single = PixelSpec(((self.view, 1),), self.size, self.samples, channels_first=True)
        images: Pixels = single.read(source, times)
        return images


class PixelObserver:
    """Renders a running episode's frames into its observation, which is the frame stack itself.

    `update` shifts the frames by one towards the oldest and renders the newest.
    """

    def __init__(self, spec: PixelSpec, out: Any) -> None:
        self.spec = spec
        self.out = empty(spec.fields) if out is None else out
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
        whole = np.moveaxis(self.out, 0, -1) if self.spec.channels_first else self.out
        shift_stack(whole)
        for renderer, stack in zip(self._renderers, self._stacks, strict=True):
            renderer.render(bodies, stack[:, :, -CHANNELS:])


def _whole(name: str, value: Any, most: int) -> int:
    """An integer from 1 to `most`; raises `ObservationError`."""
    whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if not whole or not 1 <= value <= most:
        raise ObservationError(
            f"{name}: expected an integer from 1 to {most}, found {quoted(value)}"
        )
    return int(value)


def copy_pixels(source: Pixels, out: Pixels) -> None:
    """Copy an image channel by channel: NumPy takes three times as long pixel by pixel."""
    for channel in range(CHANNELS):
        out[..., channel] = source[..., channel]


def _render_stacks(
    frames: FrameSource, indices: NDArray[np.intp], stacks: Sequence[Pixels] | Pixels
) -> None:
    """Render each frame where it appears first, and copy it to its other positions."""
    rendered: dict[int, Pixels] = {}
    for stack, times in zip(stacks, indices.tolist(), strict=True):
        for k, time in enumerate(times):
            out = stack[..., CHANNELS * k : CHANNELS * (k + 1)]
            if time in rendered:
                copy_pixels(rendered[time], out)
            else:
                frames.render(time, out)
                rendered[time] = out
