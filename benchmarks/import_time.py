"""Measures the CPU time of `import magical` in a fresh interpreter, and of its dependencies.

python benchmarks/import_time.py [--repeats N]
"""

import argparse
import statistics
import subprocess
import sys

SCRIPT = "import time; start = time.process_time(); import {}; print(time.process_time() - start)"


def seconds(modules: str) -> float:
    command = [sys.executable, "-c", SCRIPT.format(modules)]
    return float(subprocess.run(command, capture_output=True, text=True, check=True).stdout)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=20)
    repeats = parser.parse_args().repeats
    for modules in ("numpy", "gymnasium", "magical"):
        seconds(modules)  # the first import compiles to .pyc
        times = [seconds(modules) for _ in range(repeats)]
        print(
            f"import {modules:10} median {statistics.median(times):.3f} s, "
            f"slowest {max(times):.3f} s of {repeats}"
        )


if __name__ == "__main__":
    main()
