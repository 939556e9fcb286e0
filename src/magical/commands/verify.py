"""Run a sample of an entry's rollouts again, and say whether that confirms its scores.

ENTRY is a folder with scores.csv and entry.json. The policy is that of the run folder that the
entry names or lies in, a built-in one, or --policy. The scores must be equal, unless the entry
states that it was made on another machine or with other versions: then small differences in a
network's arithmetic may change single rollouts, and the mean scores, over all rollouts and in each
environment, are compared instead. In all rollouts, both scores must be equal on tasks whose two
scoring rules are the same. This finds mistakes; it does not show that a policy is honest.
"""

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING

from magical.commands._common import add_count, add_json, add_workers, print_json, print_table
from magical.messages import decimals

if TYPE_CHECKING:
    from magical.evaluation.verification import Verification

HELP = "rerun a sample of an entry's rollouts"


def configure(parser: argparse.ArgumentParser) -> None:
    """Describe the command's arguments."""
    parser.add_argument("entry", type=Path, metavar="ENTRY", help="folder of an evaluated run")
    parser.add_argument(
        "--policy",
        metavar="POLICY",
        help="the policy, as for evaluate (default: the one that the entry records)",
    )
    meaning = "batches to rerun for each task, of up to 64 rollouts, or 10 on each variant"
    add_count(parser, "--rounds", meaning, default=1)
    add_count(parser, "--seed", "seed that selects the batches (default: random)", least=0)
    add_workers(parser)
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Run again, compare, print; 1 if the scores are not confirmed."""
    import numpy as np

    from magical.evaluation import load_policy, read_entry
    from magical.evaluation.entry import policy_of
    from magical.evaluation.verification import is_elsewhere, verify
    from magical.runs.machine import machine, versions

    entry = read_entry(args.entry)
    policy = load_policy(args.policy) if args.policy else policy_of(args.entry, entry)
    found = verify(
        entry,
        policy,
        rounds=args.rounds,
        rng=np.random.default_rng(args.seed),
        elsewhere=is_elsewhere(entry.record, machine(), versions()),
        workers=args.workers,
    )
    _print(found)
    counts = {"rollouts": len(found.recorded), "total": len(entry.scores), "equal": found.equal}
    print_json(args, {"confirmed": found.confirmed, **counts, "exact": found.exact})
    return 0 if found.confirmed else 1


def _print(found: "Verification") -> None:
    from magical.tasks.axes import short_variant

    rows = [
        (
            env_id.task,
            short_variant(env_id.variant),
            len(part.recorded),
            part.equal,
            f"{sum(row.score for row in part.recorded) / len(part.recorded):.3f}",
            f"{sum(row.score for row in part.again) / len(part.again):.3f}",
        )
        for env_id, part in found.by_environment().items()
    ]
    print_table(("task", "variant", "rollouts", "equal", "recorded mean", "mean now"), rows)
    sample = f"{len(found.recorded)} of {found.total} rollouts run again"
    if found.share == 1.0:
        sample = f"all {len(found.recorded)} rollouts run again"
    elif found.exact:
        sample += f": one altered score is found with probability {found.share:.2f}"
    print(f"{sample}\n{_verdict(found)}")


def _verdict(found: "Verification") -> str:
    count = f"{found.equal} of {len(found.recorded)} rollouts have the recorded scores"
    if found.equal == len(found.recorded):
        return f"confirmed: {count}"
    if found.exact:
        return (
            f"not confirmed: {count}; all should, unless a network acts and the entry states "
            "another machine or other versions"
        )
    value, low, high = (decimals(number, 3, "+") for number in found.mean_changes()[0])
    bounds = "" if math.isnan(found.mean_changes()[0].low) else f" ({low} to {high})"
    change = f"{count}; the mean score changed by {value}{bounds}"
    elsewhere = "the entry was evaluated on another machine or with other versions"
    if found.confirmed:
        return (
            f"not contradicted: {change}, which chance can explain, as it can the changes in every "
            f"environment; {elsewhere}, where single rollouts may differ"
        )
    return (
        f"not confirmed: {change}; this, or the change in an environment, is more than chance can "
        f"explain, or rests on a single rollout; {elsewhere}"
    )
