"""Measures the demonstration store: import, file sizes, reading, observations for training.

    python benchmarks/demos.py [SRC]

SRC is a folder of published human demonstrations; without it, the import is not measured.
"""

import resource
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from magical.demos import Dataset, DatasetWriter, Frames, ObservationReader, Trajectory
from magical.demos.human.importing import find_published, import_published
from magical.physics import Simulation
from magical.processes import available_cores
from magical.tasks import TASKS

Pixels = NDArray[np.uint8]
Render = Callable[[int, Pixels], None]

SECONDS = 3.0  # duration of each rate measurement
BATCH = 64  # observations read at once, at random time steps


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        if len(sys.argv) > 1:
            measure_import(Path(sys.argv[1]), Path(folder) / "human")
        measure_recordings(Path(folder) / "random")
    for task in ("MoveToCorner", "ClusterColour"):
        measure_rendering(random_trajectory(task))


def measure_import(source: Path, out: Path) -> None:
    files = find_published(source)
    start = time.perf_counter()
    import_published(files, out, keep="frames")  # without recovering poses
    elapsed = time.perf_counter() - start
    own, workers = (
        resource.getrusage(who).ru_maxrss // 1024
        for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    )
    spent = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
    print(f"import of {len(files)} files: {elapsed:.1f} s, {spent:.1f} s of processor time, with")
    print(f"  {available_cores()} workers; peak memory {own} MB here, {workers} MB in a worker")
    report_sizes("human demonstrations", Dataset.open(out))


def measure_recordings(out: Path) -> None:
    writer = DatasetWriter(out)
    for task in TASKS:
        for seed in range(3):
            writer.append(random_trajectory(task, seed))
    report_sizes("recordings with poses, TestAll", Dataset.open(out))


def report_sizes(what: str, dataset: Dataset) -> None:
    sizes = [entry.size for entry in dataset.entries]
    start = time.perf_counter()
    for _ in dataset:
        pass
    each = (time.perf_counter() - start) / len(dataset)
    print(f"{what}: {np.mean(sizes) / 1000:.0f} kB on average, {max(sizes) / 1000:.0f} kB at most,")
    print(f"  read and checked in {1000 * each:.1f} ms each")


def measure_rendering(trajectory: Trajectory) -> None:
    rng = np.random.default_rng(0)
    num_steps = len(trajectory) + 1
    print(trajectory.env_id)
    out = np.empty((96, 96, 3), np.uint8)
    for view in ("ego", "allo"):
        render = Frames(trajectory, view).render
        rate(f"  {view} frames", 1, partial(render_any, render, rng, num_steps, out))
    reader = ObservationReader(trajectory, "LoRes4E")
    batch = np.empty((BATCH, 96, 96, 12), np.uint8)
    rate(
        f"  LoRes4E observations, random batches of {BATCH}",
        BATCH,
        lambda: reader.read(rng.integers(num_steps, size=BATCH), batch),
    )


def render_any(render: Render, rng: np.random.Generator, num_steps: int, out: Pixels) -> None:
    render(int(rng.integers(num_steps)), out)


def rate(what: str, count: int, work: Callable[[], object]) -> None:
    work()
    done, start = 0, time.process_time()
    while (spent := time.process_time() - start) < SECONDS:
        work()
        done += count
    print(f"{what}: {done / spent:,.0f} a second of one core")


def random_trajectory(task: str, seed: int = 0) -> Trajectory:
    rng = np.random.default_rng(seed)
    scene, dynamics = TASKS[task].sample("TestAll", rng)
    simulation = Simulation(scene, dynamics)
    actions = rng.integers(18, size=TASKS[task].horizon)
    poses = [simulation.poses().bodies]
    for action in actions.tolist():
        simulation.step(action)
        poses.append(simulation.poses().bodies)
    env_id = f"magical/{task}-TestAll-v0"
    return Trajectory.from_poses(env_id, scene, actions, np.stack(poses), dynamics=dynamics)


if __name__ == "__main__":
    main()
