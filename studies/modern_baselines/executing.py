"""How scores of chunk policies with continuous actions depend on what of each chunk is executed.

    python -m studies.modern_baselines.executing RUN [...] --execute N [...] [--denoise N [...]]

Evaluates each run on Demo and TestJitter, 50 rollouts with a nudge of 1e-3, with N steps of each
chunk executed, and after N denoising steps; with --round also with every part of an action rounded
to the nearest value that the demonstrators could choose (drive and turn -1, 0 or 1, grip -1 or 1).
Prints the means over runs for each task, and over tasks, as a Markdown table.
"""

import argparse
import sys
from collections import defaultdict
from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from magical.envs import EnvId
from magical.evaluation import evaluate
from magical.evaluation.policy import Mask
from magical.tasks import Horizon, get_task
from magical_baselines.algorithms.diffusion import DiffusionNetwork
from magical_baselines.policy import TrainedPolicy, load_policy

VARIANTS = ("Demo", "TestJitter")
ROLLOUTS, NUDGE = 50, 1e-3


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


def scores(run: str, rounded: bool, execute: int, denoise: int) -> list[float]:
    """A run's mean scores on the variants; `denoise` is 0 for policies that do not denoise."""
    policy = load_policy(run, "cpu")
    policy.config = policy.config.replace(execute=execute)
    if denoise:
        assert isinstance(policy.network, DiffusionNetwork)
        policy.network.denoising_steps = denoise
    (task,) = policy.tasks
    horizon: Horizon = "published" if get_task(task).has_two_horizons else None
    env_ids = [EnvId(task, variant) for variant in VARIANTS]
    acting = Rounded(policy) if rounded else policy
    rows = evaluate(acting, env_ids, rollouts=ROLLOUTS, nudge=NUDGE, horizon=horizon, workers=0)
    return [float(np.mean([row.score for row in rows if row.env_id == i])) for i in env_ids]


def main(arguments: Sequence[str]) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("runs", nargs="+", metavar="RUN")
    parser.add_argument("--execute", nargs="+", type=int, required=True, metavar="N")
    parser.add_argument("--denoise", nargs="+", type=int, default=[0], metavar="N")
    parser.add_argument("--round", action="store_true")
    args = parser.parse_args(arguments)
    ways = list(product((False, True)[: 1 + args.round], args.execute, args.denoise))
    by_task: dict[str, list[list[float]]] = defaultdict(list)
    for run in args.runs:
        (task,) = load_policy(run, "cpu").tasks
        by_task[task].append([score for way in ways for score in scores(run, *way)])
        print(task, by_task[task][-1], file=sys.stderr, flush=True)
    heads = [
        f"{v}, {n}{f' after {k}' * (k > 0)}{', rounded' * r}" for r, n, k in ways for v in VARIANTS
    ]
    rows = {task: np.mean(found, axis=0) for task, found in by_task.items()}
    rows["mean"] = np.mean(list(rows.values()), axis=0)
    print(f"| Task | {' | '.join(heads)} |\n{'| --- ' * (len(heads) + 1)}|")
    for task, means in rows.items():
        print(f"| {task} | {' | '.join(f'{value:.2f}' for value in means)} |")


if __name__ == "__main__":
    main(sys.argv[1:])
