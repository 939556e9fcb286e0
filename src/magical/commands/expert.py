"""Let the scripted experts act and score them.

`magical expert evaluate` plays unfiltered episodes with fresh seeds; without `--env`, in all
environments.
"""

import argparse
from typing import TYPE_CHECKING

from magical.commands._common import (
    add_json,
    non_negative_int,
    positive_int,
    print_json,
    print_table,
)

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

HELP = "score the scripted experts"


def configure(parser: argparse.ArgumentParser) -> None:
    """Describe the command's arguments."""
    subs = parser.add_subparsers(metavar="COMMAND", required=True)
    evaluate = subs.add_parser("evaluate", help="mean scores over many episodes")
    evaluate.add_argument(
        "--env", action="append", metavar="ENV_ID", help="may be repeated (default: all)"
    )
    evaluate.add_argument(
        "--rollouts",
        type=positive_int,
        default=100,
        metavar="N",
        help="in each environment (default: 100)",
    )
    evaluate.add_argument(
        "--seed", type=non_negative_int, default=0, metavar="N", help="default: 0"
    )
    evaluate.add_argument(
        "--skill", type=float, default=1.0, metavar="X", help="0 to 1 (default: 1)"
    )
    evaluate.add_argument(
        "--takeover",
        action="store_true",
        help="a random policy acts in the first third of each episode",
    )
    evaluate.add_argument(
        "--workers", type=positive_int, metavar="N", help="processes (default: the cores)"
    )
    add_json(evaluate)


def run(args: argparse.Namespace) -> int:
    """Evaluate, print."""
    from magical.envs import all_env_ids
    from magical.experts import evaluate_expert
    from magical.progress import progress_bar

    env_ids = args.env or all_env_ids()
    with progress_bar("rollouts", len(env_ids) * args.rollouts) as advance:
        scores = evaluate_expert(
            env_ids,
            args.rollouts,
            seed=args.seed,
            skill=args.skill,
            takeover=args.takeover,
            workers=args.workers,
            progress=advance,
        )
    results = {env_id: _summary(values) for env_id, values in scores.items()}
    _print_summaries(results)
    if args.json:
        print_json(results)
    return 0


def _summary(scores: "Sequence[float]") -> dict[str, object]:
    from statistics import fmean, pstdev

    return {"mean": fmean(scores), "std": pstdev(scores), "scores": list(scores)}


def _print_summaries(results: "Mapping[str, Mapping[str, object]]") -> None:
    rows = [(env_id, f"{r['mean']:.3f}", f"{r['std']:.3f}") for env_id, r in results.items()]
    print_table(("environment", "mean", "std"), rows)
    print(f"\nmean over {len(results)}: {sum(float(row[1]) for row in rows) / len(rows):.3f}")
