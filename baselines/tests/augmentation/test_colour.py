"""Lab colour jitter against scikit-image."""

import warnings
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from magical_baselines.augmentation.colour import colour_jitter

color = pytest.importorskip("skimage.color")
colorconv = pytest.importorskip("skimage.color.colorconv")

# float32, and scikit-image's own matrices are inverses of each other to 1e-6 only.
TOLERANCE = 3e-5


def to_lab(rgb: NDArray[np.float64], linear_light: bool) -> NDArray[np.float64]:
    """Lab of sRGB, or of the same numbers taken for linear light; (..., 3) each."""
    lab: NDArray[np.float64] = (
        color.rgb2lab(rgb) if linear_light else color.xyz2lab(rgb @ colorconv.xyz_from_rgb.T)
    )
    return lab


def from_lab(lab: NDArray[np.float64], linear_light: bool) -> NDArray[np.float64]:
    """The inverse of `to_lab`, clipped."""
    rgb = color.lab2rgb(lab) if linear_light else color.lab2xyz(lab) @ colorconv.rgb_from_xyz.T
    clipped: NDArray[np.float64] = rgb.clip(0.0, 1.0)
    return clipped


def reference(
    images: NDArray[Any],
    scales: NDArray[np.float64],
    turns: NDArray[np.float64],
    linear_light: bool = True,
) -> NDArray[np.float64]:
    """Slow and plain: to Lab, scale and turn, back. Images are (B, 3 * frames, H, W)."""
    batch, channels, height, width = images.shape
    pixels = images.reshape(batch, channels // 3, 3, height, width).transpose(0, 1, 3, 4, 2)
    out = []
    for stack, scale, turn in zip(pixels.astype(np.float64), scales, turns, strict=True):
        lab = to_lab(stack, linear_light)
        lightness, a, b = lab[..., 0] * scale, lab[..., 1], lab[..., 2]
        turned = a * np.cos(turn) - b * np.sin(turn), a * np.sin(turn) + b * np.cos(turn)
        with warnings.catch_warnings():  # it warns of negative Z, which it clips as we do
            warnings.simplefilter("ignore")
            out.append(from_lab(np.stack([lightness, *turned], axis=-1), linear_light))
    return np.array(out).transpose(0, 1, 4, 2, 3).reshape(images.shape)


@pytest.fixture
def factors() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    return np.array([0.99, 1.0, 1.01, 1.005]), np.array([-0.15, 0.15, 0.07, 0.0])


@pytest.mark.parametrize("linear_light", [True, False])
def test_every_grey_and_many_colours_of_uint8_agree_with_scikit_image(
    linear_light: bool, factors: tuple[NDArray[np.float64], NDArray[np.float64]]
) -> None:
    images = np.random.default_rng(1).integers(0, 256, (4, 6, 16, 16), dtype=np.uint8)
    images[:, :3] = np.arange(256, dtype=np.uint8).reshape(16, 16)
    ours = colour_jitter(torch.from_numpy(images) / 255.0, *factors, linear_light).numpy()
    expected = reference(images / 255.0, *factors, linear_light)
    assert np.abs(ours - expected).max() < TOLERANCE
