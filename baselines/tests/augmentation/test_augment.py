"""What augmentations do to pictures, against numpy and scikit-image."""

from dataclasses import asdict, replace
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from torch import Tensor

from magical.errors import InvalidConfigError, UnknownNameError
from magical_baselines.algorithms.bc import BCConfig
from magical_baselines.augmentation.augment import (
    NOISE_STD,
    augment,
    augment_compiled,
    augment_in_pytorch,
    sample_parameters,
    warp,
)
from magical_baselines.augmentation.names import NAMES, SETS, Augmentations, parse_augmentations

NONE = SETS["none"]


def only(name: str) -> Augmentations:
    return parse_augmentations(name)


def rng() -> np.random.Generator:
    return np.random.default_rng(5)


def smooth_stacks(batch: int = 6) -> Tensor:
    """Smooth coloured pictures, the same four times in each stack: (B, 12, 96, 96) uint8."""
    y, x = np.mgrid[0:96, 0:96] / 96.0
    waves = [np.sin(3 * x + k) * np.cos(4 * y - k) for k in range(3)]
    frame = (127 + 90 * np.array(waves)).astype(np.uint8)
    return torch.from_numpy(np.tile(frame, (batch, 4, 1, 1)))


def test_colour_jitter_needs_frames_of_three_channels() -> None:
    grey = smooth_stacks()[:, :4]
    with pytest.raises(InvalidConfigError, match="found images of 4 channels; leave out colour"):
        augment(grey, SETS["all"], rng())
    assert augment(grey, parse_augmentations("noise+rotation"), rng()).shape == grey.shape


def test_names_sets_and_combinations() -> None:
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


def test_nothing_switched_on_only_scales() -> None:
    images = smooth_stacks()
    assert torch.allclose(augment(images, NONE, rng()), images / 255.0, atol=1e-7)


@pytest.mark.parametrize("name", NAMES)
def test_each_changes_the_picture_and_stays_in_range(name: str) -> None:
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
def test_parameters_are_sampled_once_per_stack(name: str) -> None:
    changed = augment(smooth_stacks(), only(name), rng())
    frames = changed.reshape(len(changed), 4, 3, *changed.shape[2:])
    assert torch.allclose(frames, frames[:, :1].expand_as(frames), atol=1e-6)
    for other in range(1, len(changed)):
        assert not torch.allclose(changed[0], changed[other], atol=1e-3)


def test_noise_is_independent_normal_with_the_appendix_deviation() -> None:
    grey = torch.full((8, 12, 96, 96), 128, dtype=torch.uint8)
    noise = augment(grey, only("noise"), rng()) - grey / 255
    assert abs(float(noise.std()) / NOISE_STD - 1.0) < 0.01
    assert abs(float(noise.mean())) < 1e-4
    frames = noise.reshape(len(noise), 4, 3, *noise.shape[2:]).double()
    for a, b in ((frames[:, 0], frames[:, 1]), (frames[:, :, 0], frames[:, :, 1])):
        assert abs(float((a * b).mean())) < 0.01 * NOISE_STD**2
    assert abs(float((noise[0] * noise[1]).mean())) < 0.01 * NOISE_STD**2


def test_ablations_share_random_numbers() -> None:
    sampled = [sample_parameters(4, only(name), rng()) for name in ("translation", "all")]
    for i in (0, 1, 3):  # all but rotations
        np.testing.assert_array_equal(sampled[0][i], sampled[1][i])


@pytest.mark.parametrize(("borders", "padding"), [("mirror", "symmetric"), ("repeat", "edge")])
@pytest.mark.parametrize(("right", "down"), [(3, 0), (0, -4), (-2, 4)])
def test_whole_pixel_translation_moves_and_mirrors_or_repeats(
    right: int, down: int, borders: str, padding: Any
) -> None:
    images = np.random.default_rng(0).random((1, 3, 96, 96))
    shift = np.array([[right / 96, down / 96]])
    moved = warp(torch.from_numpy(images), np.zeros(1), shift, borders).numpy()
    padded = np.pad(images, ((0, 0), (0, 0), (8, 8), (8, 8)), mode=padding)
    expected = padded[:, :, 8 - down : 104 - down, 8 - right : 104 - right]
    np.testing.assert_allclose(moved, expected, atol=1e-9)


@pytest.mark.parametrize("degrees", [-5.0, 3.0])
def test_rotation_agrees_with_scikit_image(degrees: float) -> None:
    transform = pytest.importorskip("skimage.transform")
    images = np.random.default_rng(0).random((1, 3, 96, 96))
    turned = warp(torch.from_numpy(images), np.radians([degrees]), np.zeros((1, 2))).numpy()
    expected = transform.rotate(images[0].transpose(1, 2, 0), degrees, order=1, mode="symmetric")
    np.testing.assert_allclose(turned[0].transpose(1, 2, 0), expected, atol=1e-9)


def test_parameters_stay_within_the_appendix_limits() -> None:
    """A dot at a known place tells by how much a picture was moved."""
    images = torch.zeros(300, 3, 96, 96, dtype=torch.uint8)
    images[:, :, 46:50, 46:50] = 255
    moved = augment(images, only("translation"), rng())
    assert_centres(moved, limit=0.05 * 96)
    off_centre = torch.zeros(300, 3, 96, 96, dtype=torch.uint8)
    off_centre[:, :, 46:50, 86:90] = 255  # 40 pixels right of the centre
    turned = centres(augment(off_centre, only("rotation"), rng()))
    angles = np.degrees(np.arctan2(-turned[:, 1], turned[:, 0]))
    assert np.abs(angles).max() <= 5.05
    assert angles.min() < -4.5
    assert angles.max() > 4.5


def assert_centres(images: Tensor, limit: float) -> None:
    found = centres(images)
    assert np.abs(found).max() <= limit + 0.01
    assert found.min() < -0.9 * limit
    assert found.max() > 0.9 * limit


def centres(images: Tensor) -> NDArray[np.float64]:
    """Centres of mass from the middle, right and down, in pixels: (B, 2)."""
    mass = images[:, 0].double().numpy()
    places = np.arange(96) - 47.5
    total = mass.sum(axis=(1, 2))
    x = (mass.sum(axis=1) * places).sum(axis=1) / total
    y = (mass.sum(axis=2) * places).sum(axis=1) / total
    return np.stack([x, y], axis=1)


@pytest.mark.parametrize(
    ("size", "channels_last"), [((12, 96, 96), False), ((12, 96, 96), True), ((3, 20, 31), False)]
)
@pytest.mark.parametrize("names", ["colour", "translation+rotation", "all"])
@pytest.mark.parametrize(("borders", "linear_light"), [("mirror", True), ("repeat", False)])
def test_compiled_code_agrees_with_pytorch(
    names: str, borders: str, linear_light: bool, size: tuple[int, ...], channels_last: bool
) -> None:
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
