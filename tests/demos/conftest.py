"""Trajectories, and hand-made published files."""

import gzip
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

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


class Published:
    """A published file assembled opcode by opcode; every part can be replaced."""

    def __init__(self, steps: int = 2, seed: int = 0) -> None:
        rng = np.random.default_rng(seed)
        shape = (steps + 1, 2, 384, 384, 3)
        self.frames = rng.integers(256, size=shape, dtype=np.uint8)
        self.actions = rng.integers(18, size=steps)
        self.env_name = text("MoveToCorner-Demo-v0")
        self.score = b"G" + np.array(0.75, ">f8").tobytes()
        self.acts = array(self.actions)
        self.obs = [observation(array(allo), array(ego)) for allo, ego in self.frames]
        self.after = b""

    @property
    def pickle(self) -> bytes:
        """The pickle's bytes."""
        rest = b"](" + b"K\x00" * len(self.actions) + b"e](e"
        record = name("milbench.baselines.saved_trajectories", "MILBenchTrajectory")
        obs = b"](" + b"".join(self.obs) + b"e"
        trajectory = record + b"(" + self.acts + obs + rest + b"t\x81"
        items = text("trajectory") + trajectory + text("score") + self.score
        return b"\x80\x04}(" + items + text("env_name") + self.env_name + b"u." + self.after

    def observation(self, ego: NDArray[Any], shape: Sequence[int] | None = None) -> bytes:
        """An observation with another egocentric frame."""
        return observation(array(self.frames[0, 0]), array(ego, shape))

    def write(self, path: Path) -> Path:
        """Write the gzipped file."""
        path.write_bytes(gzip.compress(self.pickle, 1))
        return path


def text(value: str) -> bytes:
    return b"\x8c" + bytes([len(value)]) + value.encode()


def name(module: str, attribute: str) -> bytes:
    return text(module) + text(attribute) + b"\x93"


def array(values: NDArray[Any], shape: Sequence[int] | None = None) -> bytes:
    """An array as the published files hold it; `shape` may differ from that of `values`."""
    kind = {"<i8": ("i8", "<"), "|u1": ("u1", "|"), "<f8": ("f8", "<")}[values.dtype.str]
    made = name("numpy.core.multiarray", "_reconstruct") + name("numpy", "ndarray")
    made += b"K\x00\x85C\x01b\x87R"
    dtype = name("numpy", "dtype") + text(kind[0]) + b"K\x00K\x01\x87R"
    dtype += b"(K\x03" + text(kind[1]) + b"NNNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK\x00tb"
    sizes = b"(" + b"".join(b"J" + np.int32(n).tobytes() for n in shape or values.shape) + b"t"
    raw = values.tobytes()
    data = b"B" + np.uint32(len(raw)).tobytes() + raw
    return made + b"(K\x01" + sizes + dtype + b"\x89" + data + b"tb"


def observation(allo: bytes, ego: bytes) -> bytes:
    views = text("allo") + allo + text("ego") + ego
    return name("collections", "OrderedDict") + b")R(" + views + b"u"


@pytest.fixture
def published() -> type[Published]:
    """Makes published files by hand."""
    return Published
