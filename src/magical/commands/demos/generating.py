"""`magical demos generate`: demonstrations by the scripted experts."""

import argparse
from dataclasses import asdict

from magical.commands._common import (
    add_json,
    fraction,
    log,
    non_negative_int,
    positive_int,
    print_json,
    print_table,
)
from magical.commands.demos._shared import (
    Subparsers,
    add_command,
    add_out,
    add_workers,
)


def add_commands(subparsers: Subparsers) -> None:
    """Add the sub-command."""
    parser = add_command(subparsers, "generate", run_generate, "roll out the scripted experts")
    parser.add_argument(
        "--env", action="append", required=True, metavar="ID", help="environment; may be repeated"
    )
    parser.add_argument(
        "-n",
        type=positive_int,
        default=25,
        metavar="N",
        help="demonstrations of each (default: 25)",
    )
    add_out(parser)
    parser.add_argument("--seed", type=non_negative_int, default=0, metavar="S", help="default: 0")
    parser.add_argument(
        "--first",
        type=non_negative_int,
        default=0,
        metavar="K",
        help="number of the first attempt, to continue a series (default: 0)",
    )
    parser.add_argument(
        "--min-score", type=float, default=0.0, metavar="X", help="drop those that score less"
    )
    parser.add_argument(
        "--skill", type=float, default=1.0, metavar="K", help="below 1: deliberately worse"
    )
    parser.add_argument(
        "--perturb",
        type=fraction,
        default=0.0,
        metavar="P",
        help="share of steps, 0 to 1, with a random action in place of the expert's; learners "
        "imitate the expert's (default: 0)",
    )
    add_workers(parser)
    add_json(parser)


def run_generate(args: argparse.Namespace) -> int:
    """`magical demos generate`."""
    from magical.demos import Dataset
    from magical.demos.generate import generate
    from magical.demos.store.summary import find_duplicates
    from magical.envs import parse_env_id
    from magical.progress import progress_bar

    ids = [parse_env_id(env_id).without_preset for env_id in args.env]
    reports = []
    with progress_bar("generate", args.n * len(ids)) as advance:
        for env_id in ids:
            report = generate(
                env_id,
                args.n,
                args.out,
                seed=args.seed,
                first=args.first,
                skill=args.skill,
                perturb=args.perturb,
                min_score=args.min_score,
                workers=args.workers,
                progress=advance,
            )
            reports.append(report)
    print_table(
        ("environment", "kept", "dropped", "mean score"),
        [(r.env_id, r.kept, r.dropped, f"{sum(r.scores) / r.kept:.3f}") for r in reports],
    )
    if copies := len(find_duplicates(Dataset.open(args.out).entries)):
        log(
            f"warning: {args.out}: {copies} demonstrations equal earlier ones of the dataset; "
            "give another --seed, or continue the series with --first"
        )
    if args.json:
        print_json({"out": str(args.out), "environments": [asdict(report) for report in reports]})
    return 0
