"""CIE Lab: its constants, and the colour jitter as an affine map.

In CIE 1976 Lab both lightness and the (a, b) plane are linear in the three cube roots of the
normalised XYZ values, so scaling L and rotating (a, b) is one affine map of these roots: Lab itself
is never computed. Source: appendix B, "Colour jitter"; sRGB as in IEC 61966-2-1, white D65 for the
2 degree observer.
"""

import numpy as np
from numpy.typing import NDArray

# Linear sRGB to XYZ, and the white point it is divided by.
SRGB_TO_XYZ = np.array(
    [[0.412453, 0.357580, 0.180423], [0.212671, 0.715160, 0.072169], [0.019334, 0.119193, 0.950227]]
)
WHITE = np.array([0.95047, 1.0, 1.08883])
TO_TRISTIMULUS = SRGB_TO_XYZ / WHITE[:, None]  # linear sRGB to XYZ relative to white
FROM_TRISTIMULUS = np.linalg.inv(TO_TRISTIMULUS)

# L = 116 fy - 16, a = 500 (fx - fy), b = 200 (fy - fz), with f the (extended) cube roots.
ROOTS_TO_LAB = np.array([[0.0, 116.0, 0.0], [500.0, -500.0, 0.0], [0.0, 200.0, -200.0]])
LAB_OFFSET = np.array([-16.0, 0.0, 0.0])
LAB_TO_ROOTS = np.linalg.inv(ROOTS_TO_LAB)

# Near black, below these arguments, the power functions are replaced by straight lines.
ROOT_KNEE, ROOT_SLOPE = 0.008856, 7.787
GAMMA, GAMMA_SCALE, GAMMA_OFFSET = 2.4, 1.055, 0.055
GAMMA_KNEE, GAMMA_SLOPE = 0.0031308, 12.92

Floats = NDArray[np.float64]


def _of_roots(in_lab: Floats) -> Floats:
    """A linear map of Lab colours (without the offset) as one of the cube roots: (3, 3)."""
    return np.asarray(LAB_TO_ROOTS @ in_lab @ ROOTS_TO_LAB)


# A jitter's map is a sum of these: scale * LIGHTNESS + cos(hue) * COSINE + sin(hue) * SINE, and
# (scale - 1) * OFFSET is added.
LIGHTNESS = _of_roots(np.diag([1.0, 0.0, 0.0]))
COSINE = _of_roots(np.diag([0.0, 1.0, 1.0]))
SINE = _of_roots(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]))
OFFSET = LAB_TO_ROOTS @ LAB_OFFSET


def root_maps(scales: Floats, hues: Floats) -> tuple[Floats, Floats]:
    """The affine maps of the cube roots that the jitter amounts to: (B, 3, 3) and (B, 3).

    Args:
        scales: (B,) factors for L.
        hues: (B,) angles in radians, from a towards b.
    """
    scale, cos, sin = (v[:, None, None] for v in (scales, np.cos(hues), np.sin(hues)))
    return scale * LIGHTNESS + cos * COSINE + sin * SINE, (scales[:, None] - 1.0) * OFFSET


def decode_gamma(encoded: Floats) -> Floats:
    """Map sRGB values in [0, 1] to linear light."""
    curve = ((encoded + GAMMA_OFFSET) / GAMMA_SCALE) ** GAMMA
    return np.where(encoded > GAMMA_KNEE * GAMMA_SLOPE, curve, encoded / GAMMA_SLOPE)
