"""Paths around obstacles."""

import math

import numpy as np

from magical.experts.geometry import project_on_segments, segment_distance
from magical.experts.paths import is_clear, next_waypoint


def test_clear_path_is_straight() -> None:
    assert next_waypoint((-0.5, 0.0), (0.5, 0.0), [(0.0, 0.6)], 0.34, 0.0) == (0.5, 0.0)


def test_path_leads_around_an_obstacle() -> None:
    at, goal, wall = (-0.6, 0.0), (0.6, 0.0), [(0.0, y) for y in (0.0, 0.2, 0.4)]
    least, length = math.inf, 0.0
    for _ in range(60):
        point = next_waypoint(at, goal, wall, 0.3, 0.0)
        step = min(0.05, math.dist(at, point))
        angle = math.atan2(point[1] - at[1], point[0] - at[0])
        at = (at[0] + step * math.cos(angle), at[1] + step * math.sin(angle))
        least = min(least, *(math.dist(at, obstacle) for obstacle in wall))
        length += step
    assert math.dist(at, goal) < 0.06
    assert least > 0.22
    assert length < 2.2


def test_clear_counts_only_what_comes_closer() -> None:
    assert is_clear((0.0, 0.0), (1.0, 0.0), [(-0.1, 0.0)], 0.3)
    assert not is_clear((0.0, 0.0), (1.0, 0.0), [(0.2, 0.1)], 0.3)


def test_distance_from_a_segment_of_no_length() -> None:
    assert segment_distance((0.0, 0.0), (0.0, 0.0), (3.0, 4.0)) == 5.0


def test_projection_on_arrays_agrees_with_single_points() -> None:
    rng = np.random.default_rng(0)
    starts, ends, points = rng.uniform(-1, 1, size=(3, 50, 2))
    ends[0] = starts[0]
    shares, distances = project_on_segments(starts, ends, points)
    slow = [
        segment_distance(start, end, point)
        for start, end, point in zip(starts, ends, points, strict=True)
    ]
    np.testing.assert_allclose(distances, slow, atol=1e-12)
    nearest = starts + shares[:, None] * (ends - starts)
    np.testing.assert_allclose(np.linalg.norm(points - nearest, axis=1), slow, atol=1e-12)
    assert shares.min() == 0.0
    assert shares.max() == 1.0
