"""The fast normal noise, beside what normal noise is."""

from statistics import NormalDist

import numpy as np
import pytest
from numpy.typing import NDArray

from magical_baselines.augmentation.kernels import add_noise

SEEDS = np.array([3, 4, 5, 6], np.uint64)
COUNT = 500_000


@pytest.fixture(scope="module")
def noise() -> NDArray[np.float64]:
    """Four images' noise, in standard deviations: (4, COUNT)."""
    images = np.full((4, COUNT), 0.5, np.float32)
    add_noise(images, 0.01, SEEDS)
    return (images.astype(float) - 0.5) / 0.01


def test_moments_and_quantiles_are_normal(noise: NDArray[np.float64]) -> None:
    """Within five standard errors of two million numbers."""
    size, normal = noise.size, NormalDist()
    assert abs(noise.mean()) < 5 / size**0.5
    assert abs(noise.var() - 1.0) < 5 * (2 / size) ** 0.5
    assert abs((noise**3).mean()) < 5 * (15 / size) ** 0.5
    assert abs((noise**4).mean() - 3.0) < 5 * (96 / size) ** 0.5
    for share in (0.001, 0.01, 0.1, 0.5, 0.9, 0.999):
        below = float((noise < normal.inv_cdf(share)).mean())
        assert abs(below - share) < 5 * (share * (1 - share) / size) ** 0.5 + 2**-14


def test_numbers_are_independent(noise: NDArray[np.float64]) -> None:
    for other in (noise[1], np.roll(noise[0], 1), np.roll(noise[0], 4), np.roll(noise[0], 1024)):
        for power in (1, 2):
            a, b = noise[0] ** power, other**power
            correlation = float(np.corrcoef(a, b)[0, 1])
            assert abs(correlation) < 5 / COUNT**0.5


def test_an_image_s_noise_depends_on_its_seed_alone() -> None:
    images = np.full((4, 3, 5000), 0.5, np.float32)
    add_noise(images, 0.01, SEEDS)
    alone = np.full((1, 3, 5000), 0.5, np.float32)
    add_noise(alone, 0.01, SEEDS[2:3])
    np.testing.assert_array_equal(images[2], alone[0])
    assert not np.array_equal(images[0], images[1])


def test_results_are_clamped() -> None:
    images = np.repeat(np.array([[0.0], [1.0]], np.float32), 1500, axis=1)
    add_noise(images, 0.1, SEEDS[:2])
    assert images.min() == 0.0
    assert images.max() == 1.0
    assert 0.4 < (images[0] == 0.0).mean() < 0.6
    assert 0.4 < (images[1] == 1.0).mean() < 0.6
