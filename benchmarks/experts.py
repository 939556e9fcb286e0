"""Measures the scripted experts: python benchmarks/experts.py [SECTION]...

Sections: speed, lengths, diversity (default: all). Needs no files. For scores, also of experts
that take over, use `magical expert evaluate`.
"""

import sys
import time
from collections.abc import Iterator

import numpy as np

from magical.experts import ExpertEpisode, rollout
from magical.scene import Poses
from magical.tasks import TASKS, get_task


def main() -> None:
    names = sys.argv[1:] or list(SECTIONS)
    for name in names:
        print(f"\n{name}")
        for line in SECTIONS[name]():
            print("  " + line, flush=True)


def speed() -> Iterator[str]:
    """Expert steps per second of CPU time on one core, including physics."""
    steps, begin = 0, time.process_time()
    for task in TASKS:
        own_steps, own_begin = 0, time.process_time()
        for seed in range(8):
            own_steps += len(rollout(task, "TestAll", seed).actions)
        steps += own_steps
        yield f"{task:14} {own_steps / (time.process_time() - own_begin):8.0f} steps/s"
    yield f"{'all':14} {steps / (time.process_time() - begin):8.0f} steps/s"
    begin = time.process_time()
    for task in TASKS:
        for seed in range(25):
            rollout(task, "Demo", seed)
    yield f"25 Demo episodes of each task: {time.process_time() - begin:.0f} s of one core"


def lengths() -> Iterator[str]:
    """Control steps to lasting success in Demo."""
    for task in TASKS:
        steps = [lasting(task, rollout(task, "Demo", seed)) for seed in range(50)]
        done = [count for count in steps if count is not None]
        low, middle, high = np.percentile(done, (10, 50, 90))
        yield f"{task:14} median {middle:.0f}, 10% to 90%: {low:.0f} to {high:.0f}"


def lasting(task: str, done: ExpertEpisode) -> int | None:
    """The first step from which the score stays 1 until the end; `None` if there is none."""
    spec = get_task(task)
    scores = [spec.score(done.scene, Poses(poses)) for poses in done.poses]
    if scores[-1] < 1.0:
        return None
    return next((i + 1 for i in range(len(scores) - 1, -1, -1) if scores[i] < 1.0), 0)


def diversity() -> Iterator[str]:
    """Distinct block orders and placements (to about a block) in 25 successful Demo episodes."""
    for task in ("MatchRegions", "MakeLine", "ClusterColour", "ClusterShape"):
        orders, placements, found, seed = set(), set(), 0, 0
        while found < 25:
            done = rollout(task, "Demo", seed)
            seed += 1
            if done.score < 1.0:
                continue
            found += 1
            blocks = done.poses[:, 5:, :2]  # (T + 1, blocks, 2)
            moved = np.linalg.norm(blocks - blocks[0], axis=2) > 0.15
            when = np.where(moved.any(axis=0), moved.argmax(axis=0), 10_000)
            orders.add(tuple(i for i in np.argsort(when, kind="stable") if when[i] < 10_000))
            placements.add(tuple(np.floor(blocks[-1] * 4).astype(int).ravel().tolist()))
        yield f"{task:14} {len(orders):2} orders, {len(placements):2} placements, quarter-unit grid"


SECTIONS = {"speed": speed, "lengths": lengths, "diversity": diversity}

if __name__ == "__main__":
    main()
