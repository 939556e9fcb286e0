"""Score the scripted experts.

`magical expert evaluate` is `magical evaluate expert` with the experts' own options.
"""

import argparse
from typing import Any

from magical.commands._common import (
    add_json,
    add_rollouts,
    add_seed,
    add_several,
    add_workers,
    print_json,
    print_table,
)

HELP = "score the scripted experts"
TAKEOVER = 1 / 3  # share of each episode in which a random policy acts first


def configure(parser: argparse.ArgumentParser) -> None:
    """Describe the command's arguments."""
    subs = parser.add_subparsers(metavar="COMMAND", required=True)
    evaluate = subs.add_parser("evaluate", help="mean scores over many episodes")
    add_several(evaluate, "--env", "environment ids (default: all)", "ID")
    add_rollouts(evaluate)
    add_seed(evaluate, "which set of fixed evaluation seeds to use")
    evaluate.add_argument(
        "--takeover",
        action="store_true",
        help="a random policy acts in the first third of each episode",
    )
    add_workers(evaluate)
    add_json(evaluate)


def run(args: argparse.Namespace) -> int:
    """Evaluate, print."""
    from statistics import fmean, pstdev

    from magical.envs import all_env_ids, parse_env_id
    from magical.evaluation import evaluate
    from magical.evaluation.expert import ExpertPolicy
    from magical.evaluation.statistics import by_environment
    from magical.progress import ProgressBar

    policy = ExpertPolicy(TAKEOVER if args.takeover else 0.0)
    env_ids = [parse_env_id(env_id).without_preset for env_id in args.env or all_env_ids()]
    with ProgressBar("rollouts", len(env_ids) * args.rollouts) as bar:
        rows = evaluate(
            policy,
            env_ids,
            rollouts=args.rollouts,
            seed=args.seed,
            workers=args.workers,
            progress=bar.advance,
        )
    results: dict[str, Any] = {
        env_id: {"mean": fmean(scores), "std": pstdev(scores), "scores": scores}
        for env_id, scores in by_environment(rows).items()
    }
    table = [(env_id, f"{r['mean']:.3f}", f"{r['std']:.3f}") for env_id, r in results.items()]
    print_table(("environment", "mean", "std"), table)
    print(f"\nmean over {len(results)}: {fmean(r['mean'] for r in results.values()):.3f}")
    print_json(args, results)
    return 0
