"""Trajectories, and the command."""

import gzip
import json
import pickle
import sys
from collections import OrderedDict, namedtuple
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest

from magical.cli import main
from magical.demos import DatasetWriter, Trajectory
from magical.envs import parse_env_id
from magical.physics import Simulation
from magical.scene import POINTS
from magical.tasks import get_task

Run = Callable[..., tuple[int, dict[str, Any]]]


def make_trajectory(
    env_id: str = "magical/MoveToCorner-Demo-v0", steps: int = 12, seed: int = 0, **more: Any
) -> Trajectory:
    """A trajectory of random actions, simulated."""
    rng = np.random.default_rng(seed)
    parsed = parse_env_id(env_id)
    scene, dynamics = parsed.task_spec.sample(parsed.variant, rng)
    simulation = Simulation(scene, dynamics)
    actions = rng.integers(18, size=steps)
    bodies = [simulation.read(), *(simulation.step(POINTS[action]) for action in actions.tolist())]
    options = {"dynamics": dynamics, "seed": seed, "demonstrator": "random", **more}
    return Trajectory.from_bodies(env_id, scene, actions, np.stack(bodies), **options)


def make_frames_trajectory(steps: int = 3, seed: int = 0, **more: Any) -> Trajectory:
    """A recording that has only frames, of noise."""
    rng = np.random.default_rng(seed)
    shape = (steps + 1, 96, 96, 3)
    options = {
        "env_id": "magical/FindDupe-Demo-v0",
        "scene": get_task("FindDupe").demo,
        "actions": rng.integers(18, size=steps),
        "frames": {view: rng.integers(256, size=shape, dtype=np.uint8) for view in ("ego", "allo")},
        "published_code_score": 0.5,
        "demonstrator": "human",
    }
    return Trajectory(**{**options, **more})


MODULE = "milbench.baselines.saved_trajectories"
Record = namedtuple("MILBenchTrajectory", ("acts", "obs", "rews", "infos"), module=MODULE)


def published(steps: int = 2, seed: int = 0, **parts: Any) -> bytes:
    """The pickle of a published file, of noise; every part can be replaced."""
    rng = np.random.default_rng(seed)
    frames = rng.integers(256, size=(steps + 1, 2, 384, 384, 3), dtype=np.uint8)
    parts = {
        "acts": rng.integers(18, size=steps),
        "obs": [OrderedDict(allo=allo, ego=ego) for allo, ego in frames],
        "env_name": "MoveToCorner-Demo-v0",
        "score": 0.75,
        **parts,
    }
    record = Record(parts.pop("acts"), parts.pop("obs"), [0] * steps, [{}] * steps)
    names = ("milbench", "milbench.baselines", MODULE)
    modules = dict.fromkeys(names, SimpleNamespace(MILBenchTrajectory=Record))
    with patch.dict(sys.modules, modules):
        data = pickle.dumps({"trajectory": record, **parts}, 3)
    return data.replace(b"numpy._core.", b"numpy.core.")


def write(path: Path, data: bytes, level: int = 1) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(gzip.compress(data, level))
    return path


@pytest.fixture
def small_dataset(tmp_path: Path) -> Path:
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
