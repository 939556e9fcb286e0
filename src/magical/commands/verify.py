"""Run a sample of an entry's rollouts again, and say whether that confirms its scores.

ENTRY is a folder with scores.csv and entry.json. The policy is that of the run folder that the
entry names or lies in, a built-in one, or --policy. The scores must be equal, unless the entry
states that it was made on another machine or with other versions: then small differences in a
network's arithmetic may change single rollouts, and the mean scores, over all rollouts and in each
environment, are compared instead. In all rollouts, both scores must be equal on tasks whose two
scoring rules are the same. This finds mistakes; it does not show that a policy is honest.
"""

import argparse
from pathlib import Path
from statistics import fmean

import numpy as np

from magical.commands import _common as common
from magical.evaluation import load_policy, read_entry
from magical.evaluation.entry import policy_of
from magical.evaluation.rollouts import Verification, is_elsewhere, verify
from magical.messages import decimals
from magical.runs import machine, versions
from magical.tasks.axes import short_variant


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("entry", type=Path, metavar="ENTRY", help="folder of an evaluated run")
    meaning = "the policy, as for evaluate (default: the one that the entry records)"
    parser.add_argument("--policy", metavar="POLICY", help=meaning)
    meaning = "batches to rerun for each task, of up to 64 rollouts, or 10 on each variant"
    common.add_count(parser, "--rounds", meaning, default=1)
    meaning = "seed that selects the batches (default: random)"
    common.add_count(parser, "--seed", meaning, least=0)
    common.add_workers(parser)
    common.add_json(parser)


def run(args: argparse.Namespace) -> int:
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
    rows = [
        {
            "task": env_id.task,
            "variant": short_variant(env_id.variant),
            "rollouts": len(part.recorded),
            "equal": part.equal,
            "recorded mean": fmean(row.score for row in part.recorded),
            "mean now": fmean(row.score for row in part.again),
        }
        for env_id, part in found.by_environment().items()
    ]
    common.print_records(rows)
    some = "all" if found.share == 1 else f"{len(found.recorded)} of"
    chance = f": one altered score is found with probability {found.share:.2f}"
    chance = chance if found.exact and found.share < 1 else ""
    print(f"{some} {found.total} rollouts run again{chance}\n{_verdict(found)}")
    counts = {"rollouts": len(found.recorded), "total": len(entry.scores), "equal": found.equal}
    common.print_json(args, {"confirmed": found.confirmed, **counts, "exact": found.exact})
    return 0 if found.confirmed else 1


def _verdict(found: Verification) -> str:
    verdict = "confirmed" if found.confirmed else "not confirmed"
    count = f"{found.equal} of {len(found.recorded)} rollouts have the recorded scores"
    if found.equal == len(found.recorded):
        return f"{verdict}: {count}"
    if found.exact:
        return f"{verdict}: {count}; all should, unless the entry states other versions or machines"
    change, low, high = (decimals(number, 3, "+") for number in found.mean_changes()[0])
    return (
        f"{'not contradicted' if found.confirmed else verdict}: {count}; the mean score changed by "
        f"{change} ({low} to {high}), where chance must explain this and the changes in every "
        "environment: the entry was evaluated on another machine or with other versions"
    )
