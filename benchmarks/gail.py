"""Measures the CPU time of GAIL updates with the published code's settings, in subprocesses.

    python benchmarks/gail.py --demos DEMOS [--network narrow] [--updates 4] [--rounds 5]

Compares float32 and bfloat16, each with glibc's own settings and with freed memory kept
(`magical_baselines/run.py`), which is the default on Linux. Prints each variant's median over the
rounds, and its ratio to the first. DEMOS is a dataset with ten demonstrations of FixColour in
Demo.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median

TASK = "FixColour"
WARM_UP = 2  # updates before the first timed one
OWN = {"GLIBC_TUNABLES": ""}  # counts as chosen by the user, so the package sets nothing
WAYS = {
    f"{precision}, {name}": (precision, chosen)
    for precision in ("float32", "bfloat16")
    for name, chosen in (("glibc's settings", OWN), ("memory kept", {}))
}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--demos", required=True)
    parser.add_argument("--network", default="narrow", help="default: narrow")
    parser.add_argument("--updates", type=int, default=4, help="that are timed; default: 4")
    parser.add_argument("--rounds", type=int, default=5, help="turns of each way; default: 5")
    parser.add_argument("--precision", help=argparse.SUPPRESS)  # in the process that measures
    args = parser.parse_args()
    if args.precision:
        print(measure(args))
        return
    found: dict[str, list[float]] = {way: [] for way in WAYS}
    for _ in range(args.rounds):
        for way, (precision, chosen) in WAYS.items():
            command = [sys.executable, *sys.argv, "--precision", precision]
            environment = {**os.environ, **chosen}
            done = subprocess.run(command, env=environment, check=True, stdout=subprocess.PIPE)
            found[way].append(float(done.stdout))
    first = median(next(iter(found.values())))
    for way, seconds in found.items():
        print(f"{way}: {median(seconds):.2f} s an update, ratio {median(seconds) / first:.2f}")


def measure(args: argparse.Namespace) -> float:
    """Seconds of CPU time per update, on one thread, including environments."""
    from magical_baselines import train
    from magical_baselines.algorithms.gail import GAILConfig

    config = GAILConfig.preset(
        "published-code",
        tasks=(TASK,),
        demos=args.demos,
        network=args.network,
        precision=args.precision,
        threads=1,
        workers=1,
        evaluate_every=0,
    )
    with tempfile.TemporaryDirectory() as folder:
        run = Path(folder, "run")
        train(config, run, stop_after=WARM_UP)
        start = time.process_time()
        train(config, run, resume=True, stop_after=args.updates)
        return (time.process_time() - start) / int(args.updates)


if __name__ == "__main__":
    main()
