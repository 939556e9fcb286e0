"""Frames as lossless WebP files."""

import io

import numpy as np
import pytest
from PIL import Image

from magical.render import render_frame
from magical.scene import Poses, View
from magical.tasks import TASKS, get_task
from magical_play.frames import GAP, SAMPLES, SIZE, encode_webp, render_webp


def decode(raw: bytes) -> np.ndarray:
    with Image.open(io.BytesIO(raw)) as image:
        assert (image.format, image.mode) == ("WEBP", "RGB")
        return np.asarray(image)


@pytest.mark.parametrize("shape", [(1, 1, 3), (5, 7, 3), (384, 776, 3)])
def test_images_are_encoded_exactly(shape: tuple[int, ...]) -> None:
    pixels = np.random.default_rng(0).integers(256, size=shape, dtype=np.uint8)
    assert np.array_equal(decode(encode_webp([pixels])), pixels)


@pytest.mark.parametrize("task", TASKS)
def test_views_stand_side_by_side(task: str) -> None:
    scene = get_task(task).demo
    poses = Poses.at_rest(scene)
    frame = decode(render_webp(scene, poses, (View.EGO, View.ALLO)))
    assert frame.shape == (SIZE, 2 * SIZE + GAP, 3)
    ego, allo = (render_frame(scene, poses, view, SIZE, SAMPLES) for view in (View.EGO, View.ALLO))
    assert np.array_equal(frame[:, :SIZE], ego)
    assert np.array_equal(frame[:, -SIZE:], allo)
    assert (frame[:, SIZE:-SIZE] == 255).all()
