"""How well the controllers of single-task runs of object-bc act in the other tasks' Demo scenes.

python studies/objects/control_across_tasks.py --goals RUN RUNS... [--rollouts 16] [--seed 3]

Goals are those of a multi-task run, actions those of each single-task run's controller, so what a
row loses is what the controller has not learned from its one scene. No test variant is needed: the
settings of the controller were chosen by this measure.
"""

import argparse
from collections.abc import Sequence

import numpy as np
import torch

from magical.evaluation import environments, evaluate
from magical.learning.algorithms.object_bc import ObjectPolicy
from magical.learning.policy import TrainedPolicy, load_policy


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("runs", nargs="+", help="run folders of object-bc, whose controllers act")
    parser.add_argument("--goals", required=True, help="a multi-task run folder, whose goals count")
    parser.add_argument("--tasks", nargs="+", help="default: those of the goals")
    parser.add_argument("--rollouts", type=int, default=16)
    parser.add_argument("--seed", type=int, default=3, help="which set of fixed seeds")
    args = parser.parse_args()
    torch.set_num_threads(1)
    goals = load_policy(args.goals, device="cpu")
    tasks = args.tasks or goals.tasks
    print("| Controller | " + " | ".join(tasks) + " | mean of other tasks |")
    print("| --- " * (len(tasks) + 2) + "|")
    for run in args.runs:
        controller = load_policy(run, device="cpu")
        acting = object_policy(controller)
        policy = object_policy(goals)
        policy.controller, policy.ranges = acting.controller, acting.ranges
        policy.temperature = acting.temperature
        policy.stuck_temperature = acting.stuck_temperature
        means = score(goals, tasks, args)
        others = [m for m, task in zip(means, tasks, strict=True) if task not in controller.tasks]
        cells = " | ".join(f"{mean:.2f}" for mean in means)
        mean = f"{np.mean(others):.2f}" if others else "–"
        name = "+".join(controller.tasks) if len(controller.tasks) < len(goals.tasks) else "all"
        print(f"| {name} | {cells} | {mean} |", flush=True)


def object_policy(policy: TrainedPolicy) -> ObjectPolicy:
    """The network of a run of object-bc."""
    if not isinstance(policy.network, ObjectPolicy):
        raise SystemExit("expected a run of object-bc")
    return policy.network


def score(policy: TrainedPolicy, tasks: Sequence[str], args: argparse.Namespace) -> list[float]:
    """The mean score on the Demo variant of each task."""
    scores = evaluate(
        policy,
        environments(tasks, ["Demo"]),
        rollouts=args.rollouts,
        seed=args.seed,
        nudge=1e-4,  # so that rollouts are not all alike
        workers=1,
    )
    return [float(np.mean([s.score for s in scores if s.env_id.task == t])) for t in tasks]


if __name__ == "__main__":
    main()
