"""Frames as WebP files, lossless, made quickly: a page that is played on gets eight a second."""

import io
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from magical.render import Renderer
from magical.scene import Scene, View
from magical.scene.constants import RAW_FRAME_SIZE

SIZE = RAW_FRAME_SIZE  # pixels: height, and width of each view
SAMPLES = 2  # across a pixel, for smooth edges
GAP = 8  # white pixels between two views


class FrameEncoder:
    """Renders one scene in one or more views side by side.

    Args:
        scene: what is rendered.
        views: from left to right.
    """

    def __init__(self, scene: Scene, views: Sequence[View]) -> None:
        self._renderers = [Renderer(scene, view, SIZE, SAMPLES) for view in views]
        width = len(views) * (SIZE + GAP) - GAP
        self._pixels = np.full((SIZE, width, 3), 255, np.uint8)

    def webp(self, bodies: NDArray[np.float64]) -> bytes:
        """The frame as a WebP file; `bodies` as for `Renderer.render`."""
        for i, renderer in enumerate(self._renderers):
            left = i * (SIZE + GAP)
            renderer.render(bodies, self._pixels[:, left : left + SIZE])
        return encode_webp(self._pixels)


def encode_webp(pixels: NDArray[np.uint8]) -> bytes:
    """An image (H, W, 3) as a lossless WebP file, with the least effort of compression."""
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, "WEBP", lossless=True, quality=0, method=0)
    return file.getvalue()
