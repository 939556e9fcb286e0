"""What augmentations do to pictures, against numpy and scikit-image."""

import warnings
from dataclasses import asdict, replace
from statistics import NormalDist

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from magical.errors import UnknownNameError
from magical_baselines.algorithms.bc import BCConfig
from magical_baselines.augmentation.augment import (
    NOISE_STD,
    augment,
    augment_compiled,
    augment_in_pytorch,
    colour_jitter,
    sample_parameters,
    warp,
)
from magical_baselines.augmentation.kernels import add_noise
from magical_baselines.augmentation.names import NAMES, SETS, Augmentations, parse_augmentations

NONE = SETS["none"]


def only(name):
    return parse_augmentations(name)


def rng():
    return np.random.default_rng(5)


def smooth_stacks(batch=6):
    """Smooth coloured pictures, the same four times in each stack: (B, 12, 96, 96) uint8."""
    y, x = np.mgrid[0:96, 0:96] / 96.0
    waves = [np.sin(3 * x + k) * np.cos(4 * y - k) for k in range(3)]
    frame = (127 + 90 * np.array(waves)).astype(np.uint8)
    return torch.from_numpy(np.tile(frame, (batch, 4, 1, 1)))


def test_names_sets_and_combinations():
    assert parse_augmentations("all") == Augmentations(True, True, True, True)
    assert parse_augmentations("no-trans-rot") == Augmentations(True, False, False, True)
    assert parse_augmentations("none") == Augmentations(False, False, False, False)
    assert parse_augmentations("noise+rotation") == Augmentations(True, False, True, False)
    for name in NAMES:
        found = asdict(
            BCConfig(tasks=("MoveToRegion",), demos="d", conventions="published").augmentations(
                name
            )
        )
        assert (found["borders"], found["linear_light"]) == ("repeat", False)
        assert {n: found[n] for n in NAMES} == {n: n == name for n in NAMES}
    with pytest.raises(UnknownNameError, match=r"'blur'.*no-trans-rot.*noise, translation"):
        parse_augmentations("noise+blur")


@pytest.mark.parametrize("name", NAMES)
def test_each_changes_the_picture_and_stays_in_range(name):
    images = smooth_stacks()
    before = images.clone()
    changed = augment(images, only(name), rng())
    assert changed.shape == images.shape
    assert changed.dtype == torch.float32
    assert changed.is_contiguous(memory_format=torch.channels_last)
    assert changed.min() >= 0.0
    assert changed.max() <= 1.0
    assert (changed - images / 255.0).abs().flatten(1).mean(1).min() > 1e-4
    assert torch.equal(images, before)


@pytest.mark.parametrize("name", ["translation", "rotation", "colour"])
def test_parameters_are_sampled_once_per_stack(name):
    changed = augment(smooth_stacks(), only(name), rng())
    frames = changed.reshape(len(changed), 4, 3, *changed.shape[2:])
    assert torch.allclose(frames, frames[:, :1].expand_as(frames), atol=1e-6)
    for other in range(1, len(changed)):
        assert not torch.allclose(changed[0], changed[other], atol=1e-3)


def test_noise_is_independent_normal_with_the_appendix_deviation():
    grey = torch.full((8, 12, 96, 96), 128, dtype=torch.uint8)
    noise = augment(grey, only("noise"), rng()) - grey / 255
    assert abs(float(noise.std()) / NOISE_STD - 1.0) < 0.01
    assert abs(float(noise.mean())) < 1e-4
    frames = noise.reshape(len(noise), 4, 3, *noise.shape[2:]).double()
    for a, b in ((frames[:, 0], frames[:, 1]), (frames[:, :, 0], frames[:, :, 1])):
        assert abs(float((a * b).mean())) < 0.01 * NOISE_STD**2
    assert abs(float((noise[0] * noise[1]).mean())) < 0.01 * NOISE_STD**2


@pytest.mark.parametrize(("borders", "padding"), [("mirror", "symmetric"), ("repeat", "edge")])
@pytest.mark.parametrize(("right", "down"), [(3, 0), (0, -4), (-2, 4)])
def test_whole_pixel_translation_moves_and_mirrors_or_repeats(right, down, borders, padding):
    images = np.random.default_rng(0).random((1, 3, 96, 96))
    shift = np.array([[right / 96, down / 96]])
    moved = warp(torch.from_numpy(images), np.zeros(1), shift, borders).numpy()
    padded = np.pad(images, ((0, 0), (0, 0), (8, 8), (8, 8)), mode=padding)
    expected = padded[:, :, 8 - down : 104 - down, 8 - right : 104 - right]
    np.testing.assert_allclose(moved, expected, atol=1e-9)


@pytest.mark.parametrize("degrees", [-5.0, 3.0])
def test_rotation_agrees_with_scikit_image(degrees):
    transform = pytest.importorskip("skimage.transform")
    images = np.random.default_rng(0).random((1, 3, 96, 96))
    turned = warp(torch.from_numpy(images), np.radians([degrees]), np.zeros((1, 2))).numpy()
    expected = transform.rotate(images[0].transpose(1, 2, 0), degrees, order=1, mode="symmetric")
    np.testing.assert_allclose(turned[0].transpose(1, 2, 0), expected, atol=1e-9)


@pytest.mark.parametrize(
    ("size", "channels_last"), [((12, 96, 96), False), ((12, 96, 96), True), ((3, 20, 31), False)]
)
@pytest.mark.parametrize("names", ["colour", "translation+rotation", "all"])
@pytest.mark.parametrize(("borders", "linear_light"), [("mirror", True), ("repeat", False)])
def test_compiled_code_agrees_with_pytorch(names, borders, linear_light, size, channels_last):
    """On every colour and far beyond the borders."""
    which = replace(
        parse_augmentations(names), borders=borders, linear_light=linear_light, noise=False
    )
    images = torch.from_numpy(rng().integers(0, 256, (5, *size), dtype=np.uint8))
    if channels_last:
        images = images.contiguous(memory_format=torch.channels_last)
    lightness, hues, angles, shifts = sample_parameters(5, which, rng())
    parameters = lightness, 4 * hues, angles, 4 * shifts
    expected = augment_in_pytorch(images, which, parameters, torch.Generator())
    found = augment_compiled(images, which, parameters, np.arange(5, dtype=np.uint64))
    torch.testing.assert_close(found, expected, atol=5e-5, rtol=0.0)


SEEDS = np.array([3, 4, 5, 6], np.uint64)
COUNT = 500_000


@pytest.fixture(scope="module")
def noise():
    """Four images' noise, in standard deviations: (4, COUNT)."""
    images = np.full((4, COUNT), 0.5, np.float32)
    add_noise(images, 0.01, SEEDS)
    return (images.astype(float) - 0.5) / 0.01


def test_moments_and_quantiles_are_normal(noise):
    """Within five standard errors of two million numbers."""
    size, normal = noise.size, NormalDist()
    assert abs(noise.mean()) < 5 / size**0.5
    assert abs(noise.var() - 1.0) < 5 * (2 / size) ** 0.5
    assert abs((noise**3).mean()) < 5 * (15 / size) ** 0.5
    assert abs((noise**4).mean() - 3.0) < 5 * (96 / size) ** 0.5
    for share in (0.001, 0.01, 0.1, 0.5, 0.9, 0.999):
        below = float((noise < normal.inv_cdf(share)).mean())
        assert abs(below - share) < 5 * (share * (1 - share) / size) ** 0.5 + 2**-14


def test_numbers_are_independent(noise):
    for other in (noise[1], np.roll(noise[0], 1), np.roll(noise[0], 4), np.roll(noise[0], 1024)):
        for power in (1, 2):
            a, b = noise[0] ** power, other**power
            correlation = float(np.corrcoef(a, b)[0, 1])
            assert abs(correlation) < 5 / COUNT**0.5


def test_an_image_s_noise_depends_on_its_seed_alone():
    images = np.full((4, 3, 5000), 0.5, np.float32)
    add_noise(images, 0.01, SEEDS)
    alone = np.full((1, 3, 5000), 0.5, np.float32)
    add_noise(alone, 0.01, SEEDS[2:3])
    np.testing.assert_array_equal(images[2], alone[0])
    assert not np.array_equal(images[0], images[1])


color = pytest.importorskip("skimage.color")
colorconv = pytest.importorskip("skimage.color.colorconv")

# float32, and scikit-image's own matrices are inverses of each other to 1e-6 only.
TOLERANCE = 3e-5


def to_lab(rgb, linear_light):
    """Lab of sRGB, or of the same numbers taken for linear light; (..., 3) each."""
    lab: NDArray[np.float64] = (
        color.rgb2lab(rgb) if linear_light else color.xyz2lab(rgb @ colorconv.xyz_from_rgb.T)
    )
    return lab


def from_lab(lab, linear_light):
    """The inverse of `to_lab`, clipped."""
    rgb = color.lab2rgb(lab) if linear_light else color.lab2xyz(lab) @ colorconv.rgb_from_xyz.T
    clipped: NDArray[np.float64] = rgb.clip(0.0, 1.0)
    return clipped


def reference(images, scales, turns, linear_light=True):
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
def factors():
    return np.array([0.99, 1.0, 1.01, 1.005]), np.array([-0.15, 0.15, 0.07, 0.0])


@pytest.mark.parametrize("linear_light", [True, False])
def test_every_grey_and_many_colours_of_uint8_agree_with_scikit_image(linear_light, factors):
    images = np.random.default_rng(1).integers(0, 256, (4, 6, 16, 16), dtype=np.uint8)
    images[:, :3] = np.arange(256, dtype=np.uint8).reshape(16, 16)
    ours = colour_jitter(torch.from_numpy(images) / 255.0, *factors, linear_light).numpy()
    expected = reference(images / 255.0, *factors, linear_light)
    assert np.abs(ours - expected).max() < TOLERANCE
