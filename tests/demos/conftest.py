"""Trajectories, and the command."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from magical.cli import main
from magical.demos import DatasetWriter, Trajectory
from magical.envs import parse_env_id
from magical.physics import Simulation
from magical.scene.actions import POINTS
from magical.tasks import get_task

MakeTrajectory = Callable[..., Trajectory]
Run = Callable[..., tuple[int, dict[str, Any]]]


@pytest.fixture(scope="session")
def make_trajectory() -> MakeTrajectory:
    """Makes a trajectory of random actions, simulated."""

    def make(
        env_id: str = "magical/MoveToCorner-Demo-v0", steps: int = 12, seed: int = 0, **more: Any
    ) -> Trajectory:
        rng = np.random.default_rng(seed)
        parsed = parse_env_id(env_id)
        scene, dynamics = get_task(parsed.task).sample(parsed.variant, rng)
        simulation = Simulation(scene, dynamics)
        actions = rng.integers(18, size=steps)
        bodies = [simulation.read()]
        for action in actions.tolist():
            simulation.step(POINTS[action])
            bodies.append(simulation.read())
        options = {"dynamics": dynamics, "seed": seed, "demonstrator": "random", **more}
        return Trajectory.from_bodies(env_id, scene, actions, np.stack(bodies), **options)

    return make


@pytest.fixture
def make_frames_trajectory() -> MakeTrajectory:
    """Makes a recording that has only frames, of noise."""

    def make(steps: int = 3, seed: int = 0, **more: Any) -> Trajectory:
        rng = np.random.default_rng(seed)
        shape = (steps + 1, 96, 96, 3)
        views = ("ego", "allo")
        options = {
            "env_id": "magical/FindDupe-Demo-v0",
            "scene": get_task("FindDupe").demo,
            "actions": rng.integers(18, size=steps),
            "frames": {view: rng.integers(256, size=shape, dtype=np.uint8) for view in views},
            "published_code_score": 0.5,
            "demonstrator": "human",
        }
        return Trajectory(**{**options, **more})

    return make


@pytest.fixture
def small_dataset(tmp_path: Path, make_trajectory: MakeTrajectory) -> Path:
    """A dataset of three short trajectories."""
    path = tmp_path / "dataset"
    writer = DatasetWriter(path)
    writer.append(make_trajectory(seed=1))
    writer.append(make_trajectory("magical/FindDupe-TestAll-v0", seed=2, demonstrator="other"))
    writer.append(make_trajectory("magical/MoveToCorner-TestJitter-v0", seed=3))
    return path


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Run:
    """Runs the command; returns its exit status and JSON."""

    def call(*command: Any) -> tuple[int, dict[str, Any]]:
        status = main(["demos", *map(str, command), "--json"])
        last = capsys.readouterr().out.splitlines()[-1]
        return status, json.loads(last)

    return call
