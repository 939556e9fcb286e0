"""What an agent observes: pixels or state vectors, behind one interface.

Code outside need not know which kind of observation it has: one array, or a dict of arrays by name.
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, fields
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from gymnasium import spaces
from gymnasium.vector.utils import create_empty_array
from numpy.typing import ArrayLike, NDArray

from magical.errors import InvalidSceneError, ObservationError, PluginError, UnknownNameError
from magical.files import parse_json
from magical.messages import quoted
from magical.plugins import is_plugin, load_plugin, plugins
from magical.scene import (
    COLOURS,
    FINGERS,
    FIRST_BLOCK,
    ROBOT,
    SHAPES,
    Scene,
    View,
    chosen_samples,
    parse_word,
)
from magical.scene.constants import FRAME_SIZE, RAW_FRAME_SIZE, WORKSPACE_HALF
from magical.tasks import Task

if TYPE_CHECKING:
    from magical.render import Renderer


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


def checked(observations: Any, shape: tuple[int, ...], dtype: Any) -> NDArray[Any]:
    """Observations (B, *shape); raises `ObservationError` if they are others."""
    inputs = np.asarray(observations)
    if inputs.dtype != dtype or inputs.shape[1:] != shape:
        raise ObservationError(
            f"observations: expected {np.dtype(dtype)} of shape (B, {', '.join(map(str, shape))}), "
            f"found {inputs.dtype} of shape {inputs.shape}; make the environments with the "
            "observation that the policy was trained on"
        )
    return inputs


def stack_indices(times: ArrayLike, frames: int) -> NDArray[np.intp]:
    """The times of the frames in stacks that end at `times`: (B, frames), oldest first.

    Before the first step the first frame is repeated (docs/specification.md, section 7).
    """
    newest = np.asarray(times, np.intp)[:, None]
    indices: NDArray[np.intp] = np.maximum(newest + np.arange(1 - frames, 1), 0)
    return indices


STACK = 4  # frames
MAX_FRAMES = 1000  # of a view in one observation
CHANNELS = 3  # of a frame: red, green, blue

Pixels = NDArray[np.uint8]


@dataclass(frozen=True)
class PixelSpec(ObservationSpec):
    """The last frames of one or two views, oldest first, uint8 RGB (specification, section 7).

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
        return self._box(sum(frames for _, frames in self.parts))

    def _box(self, frames: int) -> spaces.Box:
        size, channels = self.size, CHANNELS * frames
        shape = (channels, size, size) if self.channels_first else (size, size, channels)
        return spaces.Box(0, 255, shape, np.uint8)

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
        return CHANNELS * sum(frames for _, frames in self.parts), self.size, self.size

    @property
    def components(self) -> "tuple[tuple[PixelSpec, int], ...]":
        return tuple(
            (PixelSpec(((view, 1),), self.size, self.samples, channels_first=True), frames)
            for view, frames in self.parts
        )

    def network_input(self, observations: Any) -> NDArray[Any]:
        channels, height, width = self.network_shape
        if self.channels_first:
            return checked(observations, (channels, height, width), np.uint8)
        return checked(observations, (height, width, channels), np.uint8).transpose(0, 3, 1, 2)

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


STATE = "state"  # the name of this observation

_POSE = ("x", "y", "cos", "sin")
_VELOCITY = ("velocity_x", "velocity_y", "angular_velocity")
_ROBOT = (*_POSE, *_VELOCITY, "left_angle", "right_angle", "left_velocity", "right_velocity")
_KIND = ("present", *SHAPES, *COLOURS)
_BLOCK = (*_KIND, *_POSE, *_VELOCITY)
_REGION = ("present", *COLOURS, "left", "top", "height", "width")


def _bounds(entry: str) -> tuple[float, float]:
    """The smallest and largest value of an entry; only velocities are unbounded."""
    if "velocity" in entry:
        return -np.inf, np.inf
    if entry in _POSE or entry in ("left", "top"):
        return -WORKSPACE_HALF, WORKSPACE_HALF  # also the bounds of sine and cosine
    if entry in ("left_angle", "right_angle"):
        return -np.pi, np.pi
    return 0.0, 2 * WORKSPACE_HALF if entry in ("height", "width") else 1.0


@dataclass(frozen=True)
class StateSpec(ObservationSpec):
    """A state vector: a task's true state, float32, with slots for its largest variant.

    Poses are in workspace units and radians, velocities per second:

    - robot, 11: x, y, cos, sin of its angle; its velocity x, y, angular; each finger's angle
      relative to the body (left, right); each finger's angular velocity relative to the body.
    - each block slot, 16: presence (0 or 1); shape one-hot (square, circle, pentagon, star); colour
      one-hot (red, green, blue, yellow); x, y, cos, sin of its angle; velocity x, y, angular.
    - each region slot, 9: presence; colour one-hot; left x, top y, height, width.

    Unused slots are 0. Blocks and regions are in the scene's order. `names` lists every entry.
    """

    max_blocks: int
    max_regions: int

    @property
    def names(self) -> tuple[str, ...]:
        """One name for each entry, such as `robot.x` or `block3.star`."""
        slots: list[tuple[str, tuple[str, ...]]] = [("robot", _ROBOT)]
        slots += [(f"block{i}", _BLOCK) for i in range(self.max_blocks)]
        slots += [(f"region{i}", _REGION) for i in range(self.max_regions)]
        return tuple(f"{slot}.{entry}" for slot, entries in slots for entry in entries)

    @property
    def size(self) -> int:
        """The vector's length."""
        return len(self.names)

    @property
    def space(self) -> spaces.Box:
        entries = (name.split(".")[1] for name in self.names)
        low, high = np.array([_bounds(entry) for entry in entries], np.float32).T
        return spaces.Box(low, high, dtype=np.float32)

    @property
    def num_images(self) -> int:
        return 0

    @property
    def network_shape(self) -> tuple[int, ...]:
        return (self.size,)

    @property
    def components(self) -> "tuple[tuple[StateSpec, int]]":
        return ((self, 1),)  # velocities are part of the vector

    def network_input(self, observations: Any) -> NDArray[Any]:
        return checked(observations, self.network_shape, np.float32)

    def observer(self, out: NDArray[np.float32] | None = None) -> "StateObserver":
        return StateObserver(self, out)

    def read(self, source: EpisodeSource, times: ArrayLike) -> NDArray[np.float32]:
        bodies, observer = source.body_states(), self.observer()
        observer.start(source.scene, bodies[0])
        vectors = np.empty((len(bodies), self.size), np.float32)
        for vector, step in zip(vectors, bodies, strict=True):
            observer.update(step)
            vector[:] = observer.out
        return vectors[np.asarray(times, np.intp)]

    def to_dict(self) -> str:
        return STATE  # the size follows from the task


class StateObserver:
    """Writes a running episode's state vector into a given array, or into a new one."""

    def __init__(self, spec: StateSpec, out: NDArray[np.float32] | None) -> None:
        self.spec = spec
        self.out = np.zeros(spec.size, np.float32) if out is None else out
        blocks_end = len(_ROBOT) + len(_BLOCK) * spec.max_blocks
        self._blocks = self.out[len(_ROBOT) : blocks_end].reshape(-1, len(_BLOCK))
        self._regions = self.out[blocks_end:].reshape(-1, len(_REGION))

    def start(self, scene: Scene, bodies: NDArray[np.float64]) -> None:
        """Start an episode; raises `InvalidSceneError` for a scene with too many bodies."""
        blocks, regions = self.spec.max_blocks, self.spec.max_regions
        if len(scene.blocks) > blocks or len(scene.regions) > regions:
            raise InvalidSceneError(
                f"expected at most {blocks} blocks and {regions} regions for this task's state "
                f"vector, found {len(scene.blocks)} and {len(scene.regions)}; use a pixel "
                "observation or a smaller scene"
            )
        self.out[:] = 0
        for slot, block in zip(self._blocks, scene.blocks, strict=False):
            slot[[0, 1 + SHAPES.index(block.shape), 5 + COLOURS.index(block.colour)]] = 1
        for slot, region in zip(self._regions, scene.regions, strict=False):
            slot[[0, 1 + COLOURS.index(region.colour)]] = 1
            slot[5:] = region.x, region.y, region.height, region.width
        self.update(bodies)

    def update(self, bodies: NDArray[np.float64]) -> None:
        """Observe the next step."""
        turns = bodies[:, 2]
        motion = np.column_stack([bodies[:, :2], np.cos(turns), np.sin(turns), bodies[:, 3:]])
        self.out[:7] = motion[ROBOT]
        self.out[7:11] = (bodies[FINGERS] - bodies[ROBOT])[:, [2, 5]].T.ravel()
        self._blocks[: len(bodies) - FIRST_BLOCK, len(_KIND) :] = motion[FIRST_BLOCK:]


# What `observation=` accepts: a name, a specification, a mapping of PixelSpec's fields, or None.
Observation = str | ObservationSpec | Mapping[str, Any] | None

# The presets that environment ids may name (docs/specification.md, section 7).
PRESETS: Mapping[str, PixelSpec] = {
    "LoResStack": PixelSpec(((View.ALLO, STACK), (View.EGO, STACK)), separate=True),
    "LoRes4E": PixelSpec(((View.EGO, STACK),)),
    "LoRes4A": PixelSpec(((View.ALLO, STACK),)),
    "LoRes3EA": PixelSpec(((View.ALLO, 1), (View.EGO, STACK - 1))),
    "LoResCHW4E": PixelSpec(((View.EGO, STACK),), channels_first=True),
}
RAW = PixelSpec(((View.ALLO, 1), (View.EGO, 1)), size=RAW_FRAME_SIZE, separate=True)

# Entry points for other distributions' observations: each is an `ObservationSpec`, or a function
# from the task to one, whose `to_dict` returns the name of the entry point, or `module:NAME`, for
# records of evaluations.
GROUP = "magical.observations"


def make_spec(observation: Observation, task: Task) -> ObservationSpec:
    """The specification that `observation=` selects for a task.

    Args:
        observation: the name of a preset or of an entry point, `raw` or `None` (both views at
            384 x 384), `state`, `module:NAME`, an `ObservationSpec`, or a mapping of `PixelSpec`'s
            fields.
        task: state vectors have slots for its largest variant.

    Raises:
        UnknownNameError: none of these.
        ObservationError, RenderError: invalid fields of `PixelSpec`.
        PluginError: another distribution's observation cannot be found, or is something else.
    """
    names = sorted(field.name for field in fields(PixelSpec))
    made: Any = RAW if observation is None else observation
    if isinstance(made, str):
        built_in = {**PRESETS, "raw": RAW, STATE: StateSpec(task.max_blocks, task.max_regions)}
        if made in built_in:
            return built_in[made]
        if is_plugin(GROUP, made):
            offered = load_plugin(GROUP, made)
            made = offered(task) if callable(offered) and not _is_spec(offered) else offered
            if not _is_spec(made):
                raise PluginError(
                    f"observation {observation!r}: expected an ObservationSpec, or a function from "
                    f"the task to one, found {type(made).__name__}"
                )
    elif isinstance(made, Mapping) and set(made) <= set(names):
        return PixelSpec(**made)
    if _is_spec(made):
        spec: ObservationSpec = made
        return spec
    known = ", ".join((*PRESETS, "raw", STATE, *plugins(GROUP)))
    raise UnknownNameError(
        f"observation {quoted(observation)} is unknown; expected one of {known}, module:NAME, an "
        f"ObservationSpec, or a mapping with some of {names}"
    )


def parse_spec(text: str, task: Task) -> ObservationSpec:
    """Parse an observation from untrusted text: a name, or `PixelSpec`'s fields as JSON.

    Unlike `make_spec`, this does not import `module:NAME`: the name must be one of this package's
    or that of an entry point. Raises `UnknownNameError`, for invalid fields too, and `PluginError`.
    """
    if text.startswith("{"):
        return parse_json(text, PixelSpec, "observation", UnknownNameError)
    known = (*PRESETS, "raw", STATE, *plugins(GROUP))
    if text not in known:
        raise UnknownNameError(
            f"observation {quoted(text)} is unknown here; expected one of {', '.join(known)}"
        )
    return make_spec(text, task)


def _is_spec(observation: object) -> bool:
    # isinstance of a protocol would read its properties, and `network_shape` may raise.
    return callable(getattr(type(observation), "observer", None))
