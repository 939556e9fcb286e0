"""Times sampling a scene of every variant, and scoring one.

python benchmarks/tasks.py
"""

import time
from collections.abc import Callable
from functools import partial

import numpy as np

from magical.scene import Poses
from magical.tasks import TASKS

SCENES = 500


def milliseconds(call: Callable[[], object]) -> float:
    """Mean time of a call."""
    start = time.perf_counter()
    for _ in range(SCENES):
        call()
    return (time.perf_counter() - start) / SCENES * 1e3


def main() -> None:
    """One line for each task: sampling its slowest variant, and both scores."""
    print(
        f"{'task':14} {'slowest variant':14} {'sample ms':>9} {'score ms':>9} {'published ms':>13}"
    )
    for task in TASKS.values():
        rng = np.random.default_rng(0)
        times = {v: milliseconds(partial(task.sample, v, rng)) for v in task.variants}
        slowest = max(times, key=lambda v: times[v])
        scene, _ = task.sample("TestAll", rng)
        poses = Poses.at_rest(scene)
        score = milliseconds(partial(task.score, scene, poses))
        published = milliseconds(partial(task.published_code_score, scene, poses))
        print(f"{task.name:14} {slowest:14} {times[slowest]:9.3f} {score:9.4f} {published:13.4f}")


if __name__ == "__main__":
    main()
