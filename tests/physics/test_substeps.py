"""Compiled substeps and reading: the plain loop's motions, and that loop where pymunk differs."""

import sys
import warnings
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from threading import Event, Thread

import numpy as np
import pymunk
import pytest

from magical.physics import Simulation, chipmunk
from magical.physics.simulation import compiled
from magical.scene.actions import NUM_ACTIONS
from magical.tasks import TASKS
from tests.reference import motions
from tests.reference.recordings import DATA

STEPS = 200  # of every task; many start where robot and blocks touch walls or each other


def plain(simulation: Simulation) -> Simulation:
    """The same simulation, stepped and read through pymunk's properties."""
    simulation._compiled = None
    return simulation


def history(simulation: Simulation, actions: list[int]) -> list[np.ndarray]:
    states = [simulation.read()]
    for action in actions:
        simulation.step(action)
        states.append(simulation.read())
    return states


def random_actions(seed: int) -> list[int]:
    rng = np.random.default_rng(seed)
    return np.repeat(rng.integers(NUM_ACTIONS, size=STEPS // 4), 4).tolist()


@pytest.mark.parametrize("name", TASKS)
def test_random_motions_are_the_plain_loops_to_the_last_bit(name: str) -> None:
    for seed, variant in enumerate(TASKS[name].variants):
        scene, dynamics = TASKS[name].sample(variant, np.random.default_rng(seed))
        actions = random_actions(seed)
        compiled = history(Simulation(scene, dynamics), actions)
        assert np.array_equal(compiled, history(plain(Simulation(scene, dynamics)), actions))


def test_recorded_motions_are_the_plain_loops_to_the_last_bit() -> None:
    for motion in motions.load(DATA / "motions.json").values():
        scene, actions = motions._scene(motion), motion["actions"]
        compiled = history(Simulation(scene), actions)
        assert np.array_equal(compiled, history(plain(Simulation(scene)), actions))


def test_a_written_state_is_read_back() -> None:
    scene = TASKS["ClusterColour"].demo
    simulation, other = Simulation(scene), Simulation(scene)
    states = history(simulation, random_actions(0))
    other.write(states[-1])
    assert np.array_equal(other.read(), states[-1])


def test_threads_step_simulations_of_their_own() -> None:
    def run(seed: int) -> list[np.ndarray]:
        scene, _ = TASKS["ClusterShape"].sample("TestAll", np.random.default_rng(seed))
        return history(Simulation(scene), random_actions(seed))

    seeds = range(8)
    with ThreadPoolExecutor(4) as threads:
        together = list(threads.map(run, seeds))
    for seed, states in zip(seeds, together, strict=True):
        assert np.array_equal(states, run(seed))


def test_another_thread_runs_during_a_step() -> None:
    """Only where the interpreter's lock is released: its switch interval does not end here."""
    simulation, go, ran = Simulation(TASKS["ClusterShape"].demo), Event(), Event()
    simulation.step(0)  # compiles

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
            simulation.step(0)
            steps += 1
        assert ran.is_set()
    finally:
        sys.setswitchinterval(interval)
        thread.join()


@pytest.fixture
def _unknown_yet() -> Iterator[None]:
    compiled.cache_clear()
    yield
    compiled.cache_clear()


@pytest.mark.usefixtures("_unknown_yet")
@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("SIGNATURES", {**chipmunk.SIGNATURES, "cpSpaceStep": "void(*)(struct cpSpace *, float)"}),
        ("SIGNATURES", {**chipmunk.SIGNATURES, "cpSpaceStepTwice": "void(*)(struct cpSpace *)"}),
        ("LAYOUT", chipmunk.LAYOUT[1:] + chipmunk.LAYOUT[:1]),
    ],
)
def test_another_pymunk_is_simulated_plainly_with_one_warning(
    name: str, value: object, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene, actions = TASKS["MatchRegions"].demo, random_actions(0)
    expected = history(Simulation(scene), actions)
    compiled.cache_clear()
    monkeypatch.setattr(chipmunk, name, value)
    with pytest.warns(RuntimeWarning, match=f"pymunk {pymunk.version}: expected the C functions"):
        simulation = Simulation(scene)
    with warnings.catch_warnings(action="error"):
        Simulation(scene)
    assert np.array_equal(history(simulation, actions), expected)
