"""How long a report of a whole grid takes, and how large it is, with made-up scores.

Entries of the appendix's single-task methods, on every task, five runs each, with learning curves,
are written to a temporary folder. The processor time of finding them and of making the page is
measured.
"""

import argparse
import json
import tempfile
import time
from pathlib import Path

import numpy as np

from magical import __version__
from magical.envs.seeds import evaluation_seed
from magical.evaluation import Entry, RolloutScore, environments, published_methods
from magical.report.found.search import find_results
from magical.report.pages.evaluated import write_page
from magical.tasks import TASKS

POINTS = 400  # of each run's metrics


def write_run(folder: Path, method: str, task: str, seed: int, rollouts: int) -> None:
    """One run with random scores."""
    rng = np.random.default_rng([seed, len(method), len(task)])
    scores = [
        RolloutScore(env_id, i, evaluation_seed(i), score, score)
        for env_id in environments([task])
        for i, score in enumerate(rng.random(rollouts).round(2).tolist())
    ]
    Entry(method=method, scores=scores, version=__version__).write(folder)
    config = {"algorithm": "bc", "tasks": [task], "seed": seed}
    (folder / "config.json").write_text(json.dumps(config))
    rows = [{"step": step, "loss": float(rng.random())} for step in range(POINTS)]
    (folder / "metrics.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=5, help="of each method on each task")
    parser.add_argument("--rollouts", type=int, default=100, help="on each variant")
    args = parser.parse_args()
    methods = [name for name in published_methods() if "(MT)" not in name]
    with tempfile.TemporaryDirectory() as name:
        for method in methods:
            for task in TASKS:
                for seed in range(args.runs):
                    folder = Path(name) / f"{method}-{task}-{seed}".replace("/", "-")
                    write_run(folder, method, task, seed, args.rollouts)
        start = time.process_time()
        found = find_results([name])
        read = time.process_time()
        page = Path(name) / "page.html"
        write_page(page, "Benchmark", found, methods)
        made, size = time.process_time(), page.stat().st_size
    print(f"{len(found.results)} runs of {len(methods)} methods")
    print(f"finding and reading: {read - start:.1f} s of processor time")
    print(f"the page: {made - read:.1f} s of processor time, {size / 1e6:.1f} MB")


if __name__ == "__main__":
    main()
