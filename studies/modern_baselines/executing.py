"""Whether policies with continuous actions fail because of how their actions are executed.

    python -m studies.modern_baselines.executing RUN [...]

Evaluates each run on Demo and TestJitter, 50 rollouts with a nudge of 1e-3: as it is, with one step
of each chunk executed, with every part of an action rounded to the nearest value that the
demonstrators could choose (drive and turn -1, 0 or 1, grip -1 or 1), and with both. Prints the
means over runs for each task, and over tasks, as a Markdown table.
"""

import sys
from collections import defaultdict
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from magical.envs import EnvId
from magical.evaluation import evaluate
from magical.evaluation.policy import Mask
from magical.learning.policy import TrainedPolicy, load_policy
from magical.tasks import Horizon, get_task

VARIANTS = ("Demo", "TestJitter")
ROLLOUTS, NUDGE = 50, 1e-3
WAYS = {  # whether actions are rounded, and which settings are replaced
    "as it is": (False, {}),
    "one step a chunk": (False, {"execute": 1}),
    "rounded": (True, {}),
    "rounded, one step a chunk": (True, {"execute": 1}),
}


class Rounded:
    """A policy with continuous actions, rounded to those that correspond to discrete ones."""

    def __init__(self, policy: TrainedPolicy) -> None:
        self.policy = policy
        self.observation, self.tasks = policy.observation, policy.tasks
        self.action_space = policy.action_space

    def reset(self, mask: Mask) -> None:
        self.policy.reset(mask)

    def act(
        self, observations: Any, env_ids: Sequence[EnvId], rng: np.random.Generator
    ) -> NDArray[np.float64]:
        actions = self.policy.act(observations, env_ids, rng)  # (B, 3)
        grip = np.where(actions[:, 2:] > 0.0, 1.0, -1.0)
        return np.concatenate([np.rint(actions[:, :2]), grip], axis=1)


def scores(run: str) -> tuple[str, list[float]]:
    """A run's task, and its mean scores, for each way the variants."""
    found = []
    for rounded, replaced in WAYS.values():
        policy = load_policy(run, "cpu")
        policy.config = policy.config.replace(**replaced)
        (task,) = policy.tasks
        horizon: Horizon = "published" if get_task(task).has_two_horizons else None
        env_ids = [EnvId(task, variant) for variant in VARIANTS]
        acting = Rounded(policy) if rounded else policy
        rows = evaluate(acting, env_ids, rollouts=ROLLOUTS, nudge=NUDGE, horizon=horizon, workers=0)
        found += [
            float(np.mean([row.score for row in rows if row.env_id == env_id]))
            for env_id in env_ids
        ]
    return task, found


def main(runs: Sequence[str]) -> None:
    by_task: dict[str, list[list[float]]] = defaultdict(list)
    for run in runs:
        task, found = scores(run)
        by_task[task].append(found)
        print(task, found, file=sys.stderr, flush=True)
    heads = [f"{way}: {variant}" for way in WAYS for variant in VARIANTS]
    rows = {task: np.mean(found, axis=0) for task, found in by_task.items()}
    rows["mean"] = np.mean(list(rows.values()), axis=0)
    print(f"| Task | {' | '.join(heads)} |\n{'| --- ' * (len(heads) + 1)}|")
    for task, means in rows.items():
        print(f"| {task} | {' | '.join(f'{value:.2f}' for value in means)} |")


if __name__ == "__main__":
    main(sys.argv[1:])
