"""The robot's frame, and angles."""

import math

import pytest

from magical.experts.geometry import bearing, wrap_angle
from magical.scene import Pose, Scene
from tests.experts.scenes import view_of


def test_bearing_is_the_angle_that_faces_a_point() -> None:
    view = view_of(Scene(Pose(0.1, -0.2, bearing((0.1, -0.2), (0.6, 0.4)))))
    x, y = view.to_robot_frame((0.6, 0.4))
    assert x == pytest.approx(0.0, abs=1e-12)
    assert y == pytest.approx(math.hypot(0.5, 0.6))
    assert view.point_ahead(y) == pytest.approx((0.6, 0.4))


def test_angles_are_wrapped() -> None:
    assert wrap_angle(3 * math.pi / 2) == pytest.approx(-math.pi / 2)
