"""The renderer: frames of scenes, for the rest of the package."""

import threading
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from magical.errors import RenderError
from magical.messages import quoted
from magical.render.display import display_list
from magical.render.kernel import FURTHEST, Pixels, frame_kernel, push, scratch, write
from magical.scene import FIRST_BLOCK, Pose, Poses, Scene, View, chosen_samples, parse_word
from magical.scene import constants as c

CHANNELS = 3  # of a frame: red, green, blue
STACKED = 12  # channels of the stacks that `push` shifts

Image = NDArray[np.uint8]


class _Thread(threading.local):
    def __init__(self) -> None:
        self.scratch = lru_cache(maxsize=8)(scratch)  # all renderers of a thread share it


_thread = _Thread()


class Renderer:
    """Renders one scene in one view; a frame is a pure function of the poses.

    Args:
        scene: which bodies and regions there are; its poses are not used, except the regions'.
        view: `View.EGO` or `View.ALLO`, or their names.
        size: height and width of the frame in pixels.
        samples: 1, 2 or 4; samples x samples are averaged in each pixel, halves rounded to even.
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
        size: int = c.FRAME_SIZE,
        samples: int | None = None,
        whole_dashes: bool = True,
    ) -> None:
        self.view = parse_word(View, view)
        self.size = size
        self.samples = chosen_samples(size, samples)
        self._kernel = frame_kernel(self.samples)
        self._scene = display_list(scene)
        self._count = FIRST_BLOCK + len(scene.blocks)
        self._key = self.size, self.samples, len(self._scene.ground)  # of scratch memory
        self._whole = whole_dashes
        self._ego = self.view == View.EGO
        self._ground: tuple[Any, ...] = ()  # the allocentric one, its tiles and finished pixels

    def render(self, bodies: NDArray[np.float64], out: Image) -> None:
        """Write the frame into `out`, which may be a view of any layout, such as a stack's end.

        Args:
            bodies: (5 + blocks, 3 or more): x, y, angle in the rows of `Poses`.
            out: (size, size, 3) uint8.

        Raises:
            RenderError: shapes or types do not match, or a pose is not finite or out of range.
        """
        write(self._draw(bodies, out, CHANNELS), out)

    def render_stacked(self, bodies: NDArray[np.float64], stack: Image) -> None:
        """Shift a stack by one frame and render the newest into its last three channels.

        As `render`; the stack is (size, size, 3 * frames) uint8, oldest first, of any layout.
        """
        channels = stack.shape[-1]
        pixels = self._draw(bodies, stack, max(channels - channels % CHANNELS, CHANNELS))
        if channels == STACKED and stack.flags.c_contiguous:
            words = stack.view("<u4").reshape(self.size, -1)
            if words.flags.aligned:
                push(pixels, words)
                return
        shift_stack(stack)
        write(pixels, stack[:, :, -CHANNELS:])

    def _draw(self, bodies: NDArray[np.float64], out: Image, channels: int) -> Pixels:
        shape = (self.size, self.size, channels)
        if out.shape != shape or out.dtype.char != "B" or not out.flags.writeable:
            raise RenderError(
                f"expected a writeable array {shape} of uint8 to render into, found "
                f"{out.shape} of {out.dtype}{'' if out.flags.writeable else ', read-only'}"
            )
        if bodies.ndim != 2 or bodies.shape[0] != self._count or bodies.shape[1] < 3:
            raise RenderError(
                f"expected the poses (x, y, angle) of {self._count} bodies, five of the robot's "
                f"and one for each block, found an array {bodies.shape}"
            )
        pixels, ground, tiles, *memory = _thread.scratch(*self._key)
        kept, fresh = pixels, not self._ground
        if self._ground:
            ground, tiles, kept = self._ground
        elif not self._ego:
            kept = np.empty_like(pixels)
        how = self.size, self._ego, fresh, self._whole, kept, pixels
        rows = np.array(bodies, np.float64, order="C")  # a read-only one would be compiled for anew
        count = self._kernel(*how, rows, *self._scene, ground, tiles, *memory)
        if count < 0:
            raise RenderError(
                f"expected finite poses within {FURTHEST:g} units, found {quoted(bodies.tolist())}"
            )
        if fresh and not self._ego:  # the camera does not move: its ground is drawn once
            self._ground = ground.copy(), tiles[:count].copy(), kept
        return pixels


def shift_stack(stack: Image) -> None:
    """Shift the frames of a stack (height, width, C) by one towards the oldest.

    Channels [3:] move to [:-3]; the last 3, undefined now, are to be overwritten by the newest
    frame. For contiguous memory (C-contiguous, or the transposed view of a C-contiguous
    (C, height, width) array) this is one memory move.
    """
    planes = stack.transpose(2, 0, 1)
    if stack.flags.c_contiguous:
        flat, size = stack.reshape(-1), CHANNELS
    elif planes.flags.c_contiguous:
        flat, size = planes.reshape(-1), CHANNELS * planes.shape[1] * planes.shape[2]
    else:
        stack[:, :, :-CHANNELS] = stack[:, :, CHANNELS:]
        return
    flat[:-size] = flat[size:]


def render_frame(
    scene: Scene,
    poses: Poses,
    view: View | str,
    size: int = c.FRAME_SIZE,
    samples: int | None = None,
) -> Image:
    """One frame (size, size, 3) uint8; for many frames of a scene, a `Renderer` is faster."""
    out = np.empty((size, size, CHANNELS), np.uint8)
    Renderer(scene, view, size, samples).render(poses.bodies, out)
    return out


def render_views(scene: Scene, poses: Poses) -> Image:
    """The raw egocentric and allocentric frames side by side, (384, 768, 3) uint8."""
    views = (View.EGO, View.ALLO)
    return np.concatenate([render_frame(scene, poses, v, c.RAW_FRAME_SIZE) for v in views], axis=1)


def warm_up(samples: int = max(c.SAMPLES)) -> None:
    """Compile the renderer, or load it from disk, so that the first frame is fast."""
    scene = Scene(Pose(0.0, 0.0, 0.0))
    render_frame(scene, Poses.at_rest(scene), View.EGO, 8, samples)
