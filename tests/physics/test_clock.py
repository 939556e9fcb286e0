"""The clock that measures physics alone."""

import time

import pymunk
import pytest

from magical.physics import World
from magical.physics.clock import PhysicsClock
from magical.scene.constants import SUBSTEPS
from magical.scene.scene import Pose, Scene

LONG = 0.001  # seconds that a step is made to take


@pytest.fixture
def slow_space(monkeypatch: pytest.MonkeyPatch) -> None:
    def step(space: pymunk.Space, dt: float) -> None:
        end = time.perf_counter() + LONG
        while time.perf_counter() < end:
            pass

    monkeypatch.setattr(pymunk.Space, "step", step)


@pytest.mark.usefixtures("slow_space")
def test_only_what_happens_inside_the_space_while_it_runs_counts() -> None:
    world, clock = World(Scene(Pose(0.0, 0.0, 0.0))), PhysicsClock()
    world.step(0)
    assert clock.seconds == 0
    clock.start()
    clock.start()
    world.step(0)
    clock.stop()
    once = clock.seconds
    assert once >= 0.99 * SUBSTEPS * LONG
    clock.stop()
    world.step(0)
    assert clock.seconds == once
    clock.start()
    world.step(0)
    clock.stop()
    assert clock.seconds >= once + 0.99 * SUBSTEPS * LONG


def test_stopping_leaves_pymunk_as_it_was() -> None:
    original, clock = pymunk.Space.step, PhysicsClock()
    clock.start()
    assert pymunk.Space.step is not original
    clock.stop()
    assert pymunk.Space.step is original


def test_the_clocks_own_time_is_taken_off() -> None:
    clock = PhysicsClock()
    clock.start()
    clock.stop()
    assert 0 < clock._bias < 1e-5
    clock._measured, clock._calls = 1.0, 1000
    assert clock.seconds == 1.0 - 1000 * clock._bias
