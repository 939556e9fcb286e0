"""Soak test: steps many environments for a long time, and watches memory and invariants.

python benchmarks/soak.py [--steps 1000000] [--workers K] [--observation LoRes4E]

Checks the memory of all processes, open file descriptors, shared memory mappings, that numbers are
finite, scores within [0, 1] and robots in the workspace. The exit status is 1 if memory grew by
more than 10 MB after the first 10,000 steps, if descriptors or mappings leaked, or if an invariant
is violated. Reads /proc, so it needs Linux.
"""

import argparse
import os
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import magical
from magical.envs.vector import MagicalVectorEnv
from magical.scene.actions import NUM_ACTIONS

NUM_ENVS = 32
SETTLED = 10_000  # steps after which memory must not grow any more
MAX_GROWTH = 10.0  # MB
REPORTS = 20


@dataclass(frozen=True)
class Usage:
    """The resources that some processes hold together."""

    memory: float  # MB, private to the processes
    descriptors: int  # open file descriptors
    shared: int  # shared memory mappings


def usage(process_ids: list[int]) -> Usage:
    return Usage(
        sum(private_megabytes(process_id) for process_id in process_ids),
        sum(len(list(Path(f"/proc/{i}/fd").iterdir())) for i in process_ids),
        sum(shared_mappings(process_id) for process_id in process_ids),
    )


def shared_mappings(process_id: int) -> int:
    lines = Path(f"/proc/{process_id}/maps").read_text().splitlines()
    return sum("/memfd:" in line or "/dev/shm/" in line for line in lines)


def private_megabytes(process_id: int) -> float:
    lines = Path(f"/proc/{process_id}/status").read_text().splitlines()
    (anonymous,) = (line.split()[1] for line in lines if line.startswith("RssAnon:"))
    return int(anonymous) / 1024


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--steps", type=int, default=1_000_000, help="of single environments")
    parser.add_argument("--workers", type=int, default=None)
    parser.add_argument("--observation", default="LoRes4E")
    args = parser.parse_args()
    before = usage([os.getpid()])
    start, end = soak(args.steps, args.workers, args.observation)
    after = usage([os.getpid()])
    growth = end.memory - start.memory
    print(f"memory grew by {growth:.1f} MB after the first {SETTLED:,} steps")
    print(f"descriptors: {before.descriptors} before, {after.descriptors} after")
    print(f"shared memory: {before.shared} mappings before, {after.shared} after")
    leaked = any(
        getattr(late, kind) > getattr(early, kind)
        for early, late in ((before, after), (start, end))
        for kind in ("descriptors", "shared")
    )
    return int(growth > MAX_GROWTH or leaked)


def soak(steps: int, workers: int | None, observation: str) -> tuple[Usage, Usage]:
    """Step every task's TestAll variant; returns the usage after settling and at the end."""
    ids = [str(env_id) for env_id in magical.all_env_ids() if "TestAll" in env_id]
    envs = MagicalVectorEnv(
        [ids[i % len(ids)] for i in range(NUM_ENVS)], workers=workers, observation=observation
    )
    processes = [os.getpid()]
    rng = np.random.default_rng(0)
    envs.reset(seed=0)
    began, done, settled = time.perf_counter(), 0, None
    while done < steps:
        _, rewards, _, _, infos = envs.step(rng.integers(0, NUM_ACTIONS, NUM_ENVS))
        check(envs, rewards, infos["eval_score"])
        done += NUM_ENVS
        if settled is None and done >= SETTLED:
            settled = usage(processes)
        if done * REPORTS // steps > (done - NUM_ENVS) * REPORTS // steps:
            now, rate = usage(processes), done / (time.perf_counter() - began)
            print(f"{done:>10,} steps {rate:8,.0f}/s {now}", flush=True)
    end = usage(processes)
    envs.close()
    return settled or end, end


def check(envs: MagicalVectorEnv, rewards: np.ndarray, scores: np.ndarray) -> None:
    """Check that everything is finite, scores are in [0, 1], and robots are in the workspace."""
    bodies, counts = envs.bodies
    used = np.arange(bodies.shape[1]) < counts[:, None]
    if not np.isfinite(bodies[used]).all() or not np.isfinite(rewards).all():
        raise SystemExit("expected finite numbers, found others")
    if scores.min() < 0 or scores.max() > 1:
        raise SystemExit(f"found scores outside [0, 1]: {scores}")
    if np.abs(bodies[:, 0, :2]).max() > 1:
        raise SystemExit(f"a robot left the workspace: {bodies[:, 0, :2]}")


if __name__ == "__main__":
    sys.exit(main())
