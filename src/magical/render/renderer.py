"""The renderer: frames of scenes, for the rest of the package."""

from functools import lru_cache
from threading import get_ident
from typing import Any

import numpy as np
from numpy.typing import NDArray

from magical.errors import RenderError
from magical.messages import quoted
from magical.render.canvas import working_memory
from magical.render.display import FURTHEST, display_list
from magical.render.frame import ALLO, EGO, GROUND, compiled_render
from magical.render.output import CHANNELS, push, store
from magical.scene.constants import (
    FRAME_SIZE,
    MAX_FRAME_SIZE,
    MAX_SAMPLES_ACROSS,
    RAW_FRAME_SIZE,
    SAMPLES,
)
from magical.scene.poses import FIRST_BLOCK, Poses
from magical.scene.scene import Pose, Scene
from magical.scene.vocabulary import View, parse_word

Image = NDArray[np.uint8]


@lru_cache(maxsize=64)
def _working_memory(_thread: int, *shape: int) -> tuple[NDArray[Any], ...]:
    return working_memory(*shape)


def default_samples(size: int) -> int:
    """Samples across a pixel: the fewest that make at least 384 across a frame, at most 4."""
    return next((n for n in SAMPLES if n * size >= RAW_FRAME_SIZE), max(SAMPLES))


def checked_samples(size: int, samples: int | None) -> int:
    """The samples across a pixel, `default_samples` for None; raises `RenderError`."""
    if isinstance(size, int) and 0 < size <= MAX_FRAME_SIZE and samples in (None, *SAMPLES):
        chosen = default_samples(size) if samples is None else int(samples)  # no kernel takes float
        if size * chosen <= MAX_SAMPLES_ACROSS:
            return chosen
    raise RenderError(
        f"expected a size from 1 to {MAX_FRAME_SIZE} and samples among {SAMPLES}, together at most "
        f"{MAX_SAMPLES_ACROSS} across a frame, found {quoted(size)} and {quoted(samples)}"
    )


class Renderer:
    """Renders one scene in one view; a frame is a pure function of the poses.

    Args:
        scene: which bodies and regions there are; its poses are not used, except the regions'.
        view: `View.EGO` or `View.ALLO`, or their names.
        size: height and width of the frame in pixels.
        samples: 1, 2 or 4; samples x samples are averaged in each pixel, halves rounded to even;
            at most 4096 across the frame (`MAX_SAMPLES_ACROSS`).
            Default: the fewest that make at least 384 across, at most 4. 4 at 96 pixels is the
            published pipeline, 1 at 384 its raw frame.
        whole_dashes: whether the sides of goal regions advance the pattern of dashes by whole
            pixels of the 384 frame (docs/specification.md, section 6). The human demonstrations
            were recorded with another graphics driver, which advanced it by their exact length.

    Raises:
        UnknownNameError: no such view.
        RenderError: an invalid size or number of samples.
    """

    def __init__(
        self,
        scene: Scene,
        view: View | str,
        size: int = FRAME_SIZE,
        samples: int | None = None,
        whole_dashes: bool = True,
    ) -> None:
        self.view = parse_word(View, view)
        self.size = size
        self.samples = checked_samples(size, samples)
        self._compiled = compiled_render(self.samples)
        self._display = display_list(scene)
        self._bodies = np.empty((FIRST_BLOCK + len(scene.blocks), 3))
        self._pixels = np.empty(size * size, np.int32)
        self._layers, self._whole_dashes = 1 + len(scene.regions), whole_dashes
        self._frames = np.empty((len(self._bodies) + 1, 4))
        self._thread = 0
        self._own = self._fixed_ground() if self.view == View.ALLO else None

    def render(self, bodies: NDArray[np.float64], out: Image) -> None:
        """Write the frame into `out`, which may be a view of any layout, such as a stack's end.

        Args:
            bodies: (5 + blocks, 3 or more): x, y, angle in the rows of `Poses`.
            out: (size, size, 3) uint8.

        Raises:
            RenderError: shapes or types do not match, or a pose is not finite or out of range.
        """
        self._check(out, CHANNELS)
        self._render_pixels(bodies)
        store(self._pixels, out)

    def render_stacked(self, bodies: NDArray[np.float64], stack: Image) -> None:
        """Shift a stack by one frame and render the newest into its last three channels.

        Args:
            bodies: as for `render`.
            stack: (size, size, 3 * frames) uint8, oldest first, any layout.

        Raises:
            RenderError: shapes or types do not match, or a pose is not finite or out of range.
        """
        channels = stack.shape[-1]
        self._check(stack, channels)
        if channels % CHANNELS or not channels:
            raise RenderError(f"expected a stack of whole frames, found {channels} channels")
        self._render_pixels(bodies)
        push(self._pixels, stack)

    def _check(self, out: Image, channels: int) -> None:
        shape = (self.size, self.size, channels)
        if out.shape != shape or out.dtype.char != "B" or not out.flags.writeable:
            raise RenderError(
                f"expected a writeable array {shape} of uint8 to render into, found "
                f"{out.shape} of {out.dtype}{'' if out.flags.writeable else ', read-only'}"
            )

    def _render_pixels(self, bodies: NDArray[np.float64]) -> None:
        mine = self._bodies
        if bodies.ndim != 2 or len(bodies) != len(mine) or bodies.shape[1] < mine.shape[1]:
            raise RenderError(
                f"expected the poses (x, y, angle) of {len(mine)} bodies, five of the robot's and "
                f"one for each block, found an array {bodies.shape}"
            )
        mine[:] = bodies[:, :3]
        if self._thread != get_ident():  # whose working memory the arguments have
            self._thread, self._arguments = get_ident(), self._make_arguments()
        if self._compiled(mine, *self._arguments) < 0:
            raise RenderError(
                f"expected finite poses within {FURTHEST:g} units, found {quoted(mine.tolist())}"
            )

    def _make_arguments(self) -> tuple[Any, ...]:
        pixels = self._pixels
        if self._own is None:  # the pixels are also the ground
            memory = pixels, pixels, np.empty(0, np.int32), *self._shared()
            return *self._display, *memory, self._frames, self.size, EGO, self._whole_dashes
        ground, kept, tiles = self._own
        memory = ground, pixels, kept, tiles, *self._shared()[1:]
        return *self._display, *memory, self._frames, self.size, ALLO, self._whole_dashes

    def _shared(self) -> tuple[NDArray[Any], ...]:
        """Working memory (`canvas.Canvas`), shared by all renderers of a thread.

        One call leaves nothing in it that another needs.
        """
        return _working_memory(get_ident(), self.size, self.samples, self._layers)

    def _fixed_ground(self) -> tuple[NDArray[Any], ...]:
        """The allocentric ground with its finished pixels and tiles: that camera does not move."""
        ground = np.empty_like(self._pixels)
        tiles, *shared = self._shared()
        tiles = np.empty_like(tiles)
        self._bodies[:] = 0.0
        memory = ground, self._pixels, np.empty(0, np.int32), tiles, *shared
        settings = self.size, GROUND, self._whole_dashes
        count = self._compiled(self._bodies, *self._display, *memory, self._frames, *settings)
        return ground, self._pixels.copy(), tiles[:count].copy()


def render_frame(
    scene: Scene,
    poses: Poses,
    view: View | str,
    size: int = FRAME_SIZE,
    samples: int | None = None,
) -> Image:
    """One frame (size, size, 3) uint8; for many frames of a scene, a `Renderer` is faster."""
    out = np.empty((size, size, CHANNELS), np.uint8)
    Renderer(scene, view, size, samples).render(poses.bodies, out)
    return out


def render_views(scene: Scene, poses: Poses) -> Image:
    """The raw egocentric and allocentric frames side by side, (384, 768, 3) uint8."""
    views = (View.EGO, View.ALLO)
    return np.concatenate([render_frame(scene, poses, v, RAW_FRAME_SIZE) for v in views], axis=1)


def warm_up(samples: int = max(SAMPLES)) -> None:
    """Compile the renderer, or load it from disk, so that the first frame is fast."""
    scene = Scene(Pose(0.0, 0.0, 0.0))
    render_frame(scene, Poses.at_rest(scene), View.EGO, 8, samples)
