"""Plane geometry on arrays; the same for single points is in `state_view` and `paths`."""

import math

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.intp]
Bools = NDArray[np.bool_]


def wrap_angles(angles: Floats) -> Floats:
    """The same angles in [-pi, pi)."""
    wrapped: Floats = (angles + math.pi) % (2 * math.pi) - math.pi
    return wrapped


def lengths(vectors: Floats) -> Floats:
    """Lengths (...) of vectors (..., 2)."""
    norms: Floats = np.sqrt(vectors[..., 0] ** 2 + vectors[..., 1] ** 2)
    return norms


def excess(points: Floats, limit: float) -> Floats:
    """By how much the magnitude of each coordinate exceeds a limit, or 0."""
    beyond: Floats = np.maximum(0.0, np.abs(points) - limit)
    return beyond


def project_on_segments(starts: Floats, ends: Floats, points: Floats) -> tuple[Floats, Floats]:
    """Where on a segment the point nearest to another is, and how far the two are apart.

    Args:
        starts: Segments' starts (..., 2).
        ends: Segments' ends (..., 2).
        points: Points (..., 2).

    Returns:
        Shares (...) of the segments, from 0 at the start to 1 at the end, and distances (...).
    """
    along, offsets = ends - starts, points - starts
    square = np.maximum((along * along).sum(axis=-1), 1e-12)
    shares = ((offsets * along).sum(axis=-1) / square).clip(0.0, 1.0)
    return shares, lengths(offsets - shares[..., None] * along)
