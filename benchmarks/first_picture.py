"""Measures the CPU time up to the first step after installation, when nothing is compiled yet.

python benchmarks/first_picture.py [--turns N]

Every turn is a fresh interpreter with an empty cache of compiled code.
"""

import argparse
import os
import subprocess
import sys
import tempfile

import numpy as np

PARTS = ("import", "make and reset", "step")
PROGRAM = """
import time
import gymnasium, magical
times = [0.0, time.process_time()]
env = gymnasium.make("magical/MoveToCorner-Demo-LoRes4E-v0")
env.reset(seed=0)
times.append(time.process_time())
env.step(0)
times.append(time.process_time())
print(*(after - before for before, after in zip(times, times[1:])))
"""


def turn() -> list[float]:
    """The seconds that each part takes in one turn."""
    with tempfile.TemporaryDirectory() as folder:
        done = subprocess.run(
            [sys.executable, "-c", PROGRAM],
            env={**os.environ, "NUMBA_CACHE_DIR": folder},
            capture_output=True,
            text=True,
            check=True,
        )
    return list(map(float, done.stdout.split()))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--turns", type=int, default=3)
    times = np.array([turn() for _ in range(parser.parse_args().turns)])
    for name, seconds in zip(PARTS, np.median(times, axis=0), strict=True):
        print(f"{name:15} {seconds:6.2f} s")
    print(f"{'all':15} {np.median(times.sum(axis=1)):6.2f} s")


if __name__ == "__main__":
    main()
