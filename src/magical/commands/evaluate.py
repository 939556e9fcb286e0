"""Evaluate a policy with fixed seeds: 100 rollouts on each variant of each task.

POLICY is a run folder, `random`, `noop`, `expert`, or a policy of your own as `module:name` or
`file.py:name` (docs/protocol.md).
"""

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from magical.commands._common import (
    add_json,
    log,
    non_negative_int,
    positive_int,
    print_json,
    print_table,
)
from magical.commands._policies import evaluation_details

if TYPE_CHECKING:
    from magical.evaluation import Entry, Policy, RolloutScore

HELP = "score a policy on the test variants"


def configure(parser: argparse.ArgumentParser) -> None:
    """Describe the command's arguments."""
    parser.add_argument(
        "policy", metavar="POLICY", help="a run folder, random, noop, expert or module:name"
    )
    parser.add_argument(
        "--task", action="append", metavar="TASK", help="may be repeated (default: the policy's)"
    )
    parser.add_argument(
        "--variants", nargs="+", metavar="VARIANT", help="such as Demo Jitter (default: all)"
    )
    _configure_episodes(parser)
    parser.add_argument(
        "--observation", metavar="PRESET", help="default: the policy's own, or LoRes4E"
    )
    parser.add_argument(
        "--workers", type=non_negative_int, metavar="N", help="processes (default: the cores)"
    )
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="write scores.csv and entry.json there"
    )
    parser.add_argument("--method", metavar="NAME", help="name in tables (default: the policy's)")
    add_json(parser)


def _configure_episodes(parser: argparse.ArgumentParser) -> None:
    """The arguments that say which episodes are rolled out."""
    parser.add_argument(
        "--rollouts",
        type=positive_int,
        default=100,
        metavar="N",
        help="on each variant (default: 100)",
    )
    parser.add_argument(
        "--horizon",
        type=_horizon,
        metavar="STEPS",
        help="control steps (default: the paper's); `published`: 240 for the Cluster tasks",
    )
    parser.add_argument(
        "--nudge",
        type=_nudge,
        default=0.0,
        metavar="X",
        help="shift initial poses by up to X units and radians, sampled from each rollout's seed; "
        "1e-9 averages over what rounding decides (default: 0)",
    )
    parser.add_argument(
        "--seed",
        type=non_negative_int,
        default=0,
        metavar="N",
        help="which set of fixed seeds (default: 0)",
    )


def _horizon(text: str) -> int | str:
    return text if text == "published" else positive_int(text)


def _nudge(text: str) -> float:
    from magical.envs.episode import checked_nudge

    try:
        return checked_nudge(float(text))
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from error


def run(args: argparse.Namespace) -> int:
    """Evaluate, print, write."""
    from magical.evaluation import environments, evaluate, load_policy, summarise
    from magical.progress import progress_bar

    policy = load_policy(args.policy)
    env_ids = environments(args.task or getattr(policy, "tasks", None), args.variants)
    if args.out:
        entry = make_entry(args, policy)
        entry.check_writable(args.out)
    with progress_bar("rollouts", len(env_ids) * args.rollouts) as advance:
        scores = evaluate(
            policy,
            env_ids,
            rollouts=args.rollouts,
            seed=args.seed,
            observation=args.observation,
            horizon=args.horizon,
            nudge=args.nudge,
            workers=args.workers,
            progress=advance,
        )
    print_scores(scores)
    if args.out:
        replace(entry, scores=scores).write(args.out)
        log(f"wrote scores.csv and entry.json to {args.out}")
    if args.json:
        print_json(summarise(scores))
    return 0


def make_entry(args: argparse.Namespace, policy: "Policy") -> "Entry":
    """The evaluation as it is kept on disk, but for the scores."""
    from magical import __version__
    from magical.evaluation import Entry
    from magical.evaluation.policy import is_privileged
    from magical.evaluation.rollouts import observation_for

    return Entry(
        method=args.method or Path(args.policy).absolute().name,  # of "." too
        scores=(),
        observation=str(observation_for(policy, args.observation)),
        privileged=is_privileged(policy),
        horizon="appendix" if args.horizon is None else str(args.horizon),
        nudge=args.nudge,
        seed=args.seed,
        version=__version__,
        details=evaluation_details(args.policy, args.out),
    )


def print_scores(scores: "Sequence[RolloutScore]") -> None:
    """Print a row for each environment, then the generalisation gap over all tasks."""
    from magical.evaluation import by_variant
    from magical.evaluation.intervals import rollout_mean

    header = ("task", "variant", "mean", "95% interval", "std", "gap", "published code's rule")
    rows = []
    for task, cells in by_variant(scores).items():
        for variant, cell in cells.items():
            rollouts = np.array([row.score for row in cell])
            value, low, high = rollout_mean(rollouts)
            published = np.mean([row.published_code_score for row in cell])
            rows.append(
                (
                    task,
                    variant,
                    f"{value:.3f}",
                    f"{low:.3f} to {high:.3f}",
                    f"{rollouts.std():.3f}",
                    _gap(cells, variant),
                    f"{published:.3f}",
                )
            )
    print_table(header, rows)
    print(_note(scores))


def _gap(cells: "Mapping[str, Sequence[RolloutScore]]", variant: str) -> str:
    """One task's generalisation gap along one axis; empty where there is none."""
    from magical.evaluation.statistics import generalisation_gap, run_means

    if variant == "Demo" or "Demo" not in cells:
        return ""
    pair = [cells["Demo"], cells[variant]]
    env_ids = [cell[0].env_id for cell in pair]
    means = run_means([[row for cell in pair for row in cell]], env_ids)
    return f"{generalisation_gap(means, env_ids, variant).value:.3f}"


def _note(scores: "Sequence[RolloutScore]") -> str:
    """What the intervals are over, and the generalisation gap if Demo and TestAll are there."""
    from magical.evaluation.statistics import gap_weights, over_rollouts

    note = "Intervals are over rollouts and do not include the spread between training runs."
    env_ids = list(dict.fromkeys(row.env_id for row in scores))
    try:
        weights = gap_weights(env_ids)
    except ValueError:
        return note
    value, low, high = over_rollouts([scores], env_ids, weights)
    return f"generalisation gap (Demo minus TestAll): {value:.3f} ({low:.3f} to {high:.3f})\n{note}"
