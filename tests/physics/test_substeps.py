"""Compiled control steps, of one simulation and of several."""

import sys
from threading import Event, Thread
from typing import Any

import numpy as np
import pytest

from magical.errors import MissingDependencyError
from magical.physics import Simulation, substeps
from magical.scene import POINTS
from magical.tasks import TASKS

STEPS = 200  # of every task; many start where robot and blocks touch walls or each other
Points = Any  # (T, 3): drive, turn, grip


def history(simulation: Simulation, points: Points) -> list[np.ndarray]:
    return [simulation.read(), *map(simulation.step, points)]


def random_points(seed: int) -> Points:
    """Discrete actions and others, each repeated four times."""
    rng = np.random.default_rng(seed)
    points = np.array(POINTS)[rng.integers(len(POINTS), size=STEPS // 4)]
    points[::3] = rng.uniform(-1.0, 1.0, points[::3].shape)
    return np.repeat(points, 4, axis=0)


def test_simulations_that_are_stepped_together_move_as_alone() -> None:
    starts = [TASKS[name].sample("TestAll", np.random.default_rng(0)) for name in TASKS]
    simulations, alone = ([Simulation(*start) for start in starts] for _ in range(2))
    most = max(len(each.places) for each in simulations)
    places = np.zeros((len(starts), most, 2), np.int64)
    for row, each in enumerate(simulations):
        places[row, : len(each.places)] = each.places
    robots, out = np.stack([each.robot for each in simulations]), np.zeros((len(starts), most, 6))
    rows = np.array([5, 0, 2])
    for point in random_points(0)[:40]:
        substeps.step_rows(rows, robots, places, np.array([point] * len(starts)), out)
        for row in rows:
            expected = alone[row].step(point)
            assert np.array_equal(out[row, : len(expected)], expected)
            assert not out[row, len(expected) :].any()
    assert not out[1].any()


def test_a_written_state_is_read_back() -> None:
    scene = TASKS["ClusterColour"].demo
    simulation, other = Simulation(scene), Simulation(scene)
    states = history(simulation, random_points(0))
    other.write(states[-1])
    assert np.array_equal(other.read(), states[-1])


def test_another_thread_runs_during_a_step() -> None:
    """Only where the interpreter's lock is released: its switch interval does not end here."""
    simulation, go, ran = Simulation(TASKS["ClusterShape"].demo), Event(), Event()
    simulation.step(POINTS[0])  # compiles

    def wait() -> None:
        go.wait()
        ran.set()

    thread = Thread(target=wait)
    thread.start()
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e4)
    try:
        go.set()
        steps = 0
        while steps < 20_000 and not ran.is_set():
            simulation.step(POINTS[0])
            steps += 1
        assert ran.is_set()
    finally:
        sys.setswitchinterval(interval)
        thread.join()


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("SIGNATURES", {**substeps.SIGNATURES, "cpSpaceStep": "void(*)(struct cpSpace *, float)"}),
        ("SIGNATURES", {**substeps.SIGNATURES, "cpSpaceStepTwice": "void(*)(struct cpSpace *)"}),
        ("LAYOUT", substeps.LAYOUT[1:] + substeps.LAYOUT[:1]),
    ],
)
def test_another_pymunk_is_refused(
    name: str, value: object, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(substeps, name, value)
    with pytest.raises(MissingDependencyError, match=r"pip install 'pymunk>=7.3,<7.4'"):
        substeps.c_functions()
