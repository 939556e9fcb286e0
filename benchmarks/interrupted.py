"""A plan that is killed at random moments and started again, beside one that ran through.

    python benchmarks/interrupted.py quick --out runs/through --kills 0
    python benchmarks/interrupted.py quick --out runs/killed --beside runs/through
    python benchmarks/interrupted.py quick --out runs/ray --kills 0 \
        --beside runs/through --executor ray --workers 2

`magical run` is killed with SIGKILL and given again, until the plan is complete. Prints the wall
time of every start and, with `--beside`, whether each run's `scores.csv` is equal byte for byte to
that of the other folder. The exit status is 1 if one differs, or if a run was done twice.
"""

import argparse
import json
import random
import re
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

from magical.runs.plan import RUNS, listed_runs

DONE = re.compile(r"^done: (.*) \(", re.MULTILINE)


def start(command: list[str], kill_after: float | None, log: Path) -> tuple[bool, float]:
    """Run the command until it ends, or until it is killed; whether it was, and the seconds."""
    began = time.perf_counter()
    with log.open("ab") as file:
        process = subprocess.Popen(command, stdout=file, stderr=file)
        try:
            process.wait(kill_after)
            killed = False
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
            killed = True
    if not killed and process.returncode:
        raise SystemExit(f"{' '.join(command)}: exit status {process.returncode}, see {log}")
    return killed, time.perf_counter() - began


def run_and_kill(arguments: argparse.Namespace, options: list[str]) -> Path:
    """Execute the plan with its kills; the log of all starts."""
    rng = random.Random(arguments.seed)
    log: Path = arguments.out.with_suffix(".log")
    log.parent.mkdir(parents=True, exist_ok=True)
    plan = [str(arguments.plan), "--out", str(arguments.out)]
    command = [sys.executable, "-m", "magical", "run", *plan, *options]
    low, high = arguments.between
    moments = [rng.uniform(low, high) for _ in range(arguments.kills)]
    total = 0.0
    for kill_after in [*moments, None]:
        killed, seconds = start(command, kill_after, log)
        total += seconds
        print(f"{'killed after' if killed else 'complete after'} {seconds:.0f} s", flush=True)
        if not killed:
            break
    print(f"wall time of all starts: {total:.0f} s")
    return log


def check(arguments: argparse.Namespace, log: Path) -> bool:
    """Print and return whether no run was done twice and all scores equal the other folder's."""
    done = Counter(DONE.findall(log.read_text(errors="replace")))
    twice = [name for name, times in done.items() if times > 1]
    folders = [run.folder for run in listed_runs(arguments.out)]
    print(f"runs: {len(folders)}; done twice: {', '.join(twice) or 'none'}")
    if not arguments.beside:
        return not twice
    equal = [_scores(arguments.out, name) == _scores(arguments.beside, name) for name in folders]
    print(f"scores equal to those of {arguments.beside}: {sum(equal)} of {len(folders)} runs")
    return all(equal) and not twice


def _scores(out: Path, folder: str) -> bytes:
    run = out / RUNS / folder
    assert json.loads((run / "result.json").read_text())["state"] == "done"
    return (run / "scores.csv").read_bytes()


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog="Other options are given to `magical run`.",
    )
    add = parser.add_argument
    add("plan", type=Path, metavar="PLAN")
    add("--out", type=Path, required=True, help="the results folder")
    add("--kills", type=int, default=3, help="how often (default: 3)")
    add(
        "--between",
        nargs=2,
        type=float,
        default=(60.0, 300.0),
        metavar=("LOW", "HIGH"),
        help="seconds from a start to its kill, sampled uniformly (default: 60 300)",
    )
    add("--seed", type=int, default=0, help="of the moments (default: 0)")
    add("--beside", type=Path, metavar="DIR", help="results of the same plan to compare with")
    arguments, options = parser.parse_known_args()
    sys.exit(not check(arguments, run_and_kill(arguments, options)))


if __name__ == "__main__":
    main()
