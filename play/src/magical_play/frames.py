"""Frames as lossless WebP files, encoded quickly: a page gets eight per second during play."""

import io
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from magical.render import render_frame
from magical.scene import Poses, Scene, View
from magical.scene.constants import RAW_FRAME_SIZE

SIZE = RAW_FRAME_SIZE  # pixels: height, and width of each view
SAMPLES = 2  # across a pixel, for smooth edges
GAP = 8  # white pixels between two views of this size; proportionally less for smaller frames


def render_webp(scene: Scene, poses: Poses, views: Sequence[View]) -> bytes:
    """A scene in one or more views, from left to right, as a WebP file."""
    return encode_webp([render_frame(scene, poses, view, SIZE, SAMPLES) for view in views])


def encode_webp(frames: Sequence[NDArray[np.uint8]]) -> bytes:
    """Encode frames (H, W, 3) of equal height, from left to right, as one WebP file.

    The file is lossless, encoded with the least compression effort.
    """
    height = len(frames[0])
    gap = np.full((height, GAP * height // SIZE, 3), 255, np.uint8)
    parts = [part for frame in frames for part in (gap, frame)]
    file = io.BytesIO()
    pixels = np.concatenate(parts[1:], axis=1)
    Image.fromarray(pixels).save(file, "WEBP", lossless=True, quality=0, method=0)
    return file.getvalue()
