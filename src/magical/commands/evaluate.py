"""Evaluate a policy with fixed seeds: 100 rollouts on each variant of each task.

POLICY is a run folder, `random`, `noop`, `expert`, or a policy of your own as `module:name` or
`file.py:name` (docs/own-policy.md).
"""

import argparse
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from magical.commands._common import (
    UsageError,
    add_count,
    add_json,
    add_number,
    add_out,
    add_rollouts,
    add_seed,
    add_several,
    add_tasks,
    add_workers,
    explained,
    log,
    print_json,
    print_table,
)
from magical.errors import MagicalError
from magical.evaluation.protocol import MAX_NOISE
from magical.messages import decimals, quoted
from magical.runs.sources import parse_source
from magical.tasks import parse_horizon

if TYPE_CHECKING:
    from magical.evaluation import Policy, Record, RolloutScore

HELP = "score a policy on the test variants"


def configure(parser: argparse.ArgumentParser) -> None:
    """Describe the command's arguments."""
    parser.add_argument(
        "policy",
        metavar="POLICY",
        help="a run folder, random, noop, expert, a plug-in's name, LOADER:PATH, module:name or "
        "file.py:name",
    )
    add_tasks(parser, "the policy's tasks, or all")
    add_several(parser, "--variants", "variants, such as Demo Jitter (default: all)", "VARIANT")
    add_rollouts(parser)
    parser.add_argument(
        "--horizon",
        type=explained(parse_horizon),
        metavar="STEPS",
        help="control steps per episode (default: the paper's); `published`: 240 for the Cluster "
        "tasks",
    )
    meaning = (
        "shift initial poses randomly by up to X units and radians, seeded by the rollout's seed; "
        "1e-9 averages over effects of rounding"
    )
    add_number(parser, "--noise", meaning, default=None, most=MAX_NOISE)
    add_seed(parser, "which set of fixed seeds to use")
    parser.add_argument(
        "--observation",
        metavar="PRESET",
        help="observation preset (default: the policy's own, or LoRes4E)",
    )
    add_workers(parser)
    add_out(parser, "folder to write scores.csv and entry.json to")
    parser.add_argument("--method", metavar="NAME", help="name in tables (default: POLICY's)")
    parser.add_argument(
        "--leaderboard",
        action="store_true",
        help="follow the leaderboard's protocol: use evaluation noise of 1e-9, and stop before any "
        "rollout if the entry would not be ranked",
    )
    parser.add_argument(
        "--learned-from",
        nargs="*",
        action="extend",
        type=explained(parse_source),
        metavar="SOURCE",
        help='what the policy learned from, such as demonstrations or "rendered states"; not '
        "needed for run folders, which record it",
    )
    add_count(parser, "--training-seed", "the training run's seed; run folders record it", least=0)
    meaning = "how often test variants were evaluated while the method was designed"
    add_count(parser, "--test-evaluations", meaning, least=0)
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Evaluate, print, write."""
    from magical.evaluation import Entry, environments, load_policy, summarise
    from magical.evaluation.protocol import NUDGE, Evaluation
    from magical.evaluation.rollouts import roll_out
    from magical.processes import checked_workers
    from magical.progress import ProgressBar

    policy = load_policy(args.policy)
    _check_options(args, policy)
    nudge = NUDGE if args.leaderboard else 0.0
    evaluation = Evaluation.of(
        environments(args.task or getattr(policy, "tasks", None), args.variants),
        rollouts=args.rollouts,
        seed=args.seed,
        observation=args.observation,
        horizon=args.horizon,
        nudge=nudge if args.noise is None else args.noise,
    )
    if args.out:
        method = args.method
        if method is None:
            method = Path(args.policy).absolute().name  # also of "."
        entry = Entry.of(policy, evaluation, method=method, record=_record(args, policy))
        if args.leaderboard:
            from magical.report.leaderboard import faults

            if why := faults(entry):
                raise UsageError(f"--leaderboard: the entry would not be ranked: {'; '.join(why)}")
        _prepare_folder(args, entry.record.policy)
    done, planned = getattr(policy, "updates", None) or (0, 0)
    if done < planned:
        log(
            f"warning: {args.policy}: training is unfinished: {done} of {planned} updates are "
            "done; magical train with --resume continues it"
        )
    with ProgressBar("rollouts", len(evaluation.env_ids) * args.rollouts) as bar:
        workers = checked_workers(args.workers)
        scores = roll_out(policy, evaluation, workers=workers, progress=bar.advance)
    print_scores(scores)
    if args.out:
        replace(entry, scores=scores).write(args.out)
        log(f"wrote scores.csv and entry.json to {args.out}")
    unfinished = {"unfinished": {"done": done, "planned": planned}} if done < planned else {}
    print_json(args, summarise(scores) | unfinished)
    return 0


def _check_options(args: argparse.Namespace, policy: "Policy") -> None:
    own = getattr(policy, "observation", None)
    if args.observation and own not in (None, args.observation):
        raise UsageError(
            f"--observation {args.observation}: the policy states its own observation, {own}"
        )
    options = ("leaderboard", "method", "learned_from", "training_seed", "test_evaluations")
    for option in options:
        value = getattr(args, option)
        if not args.out and value is not None and value is not False:
            raise UsageError(f"--{option.replace('_', '-')} needs --out, which writes the entry")


def _record(args: argparse.Namespace, policy: "Policy") -> "Record":
    """What the entry states about the policy: what it records, and the options."""
    from magical.evaluation.entry import record_of

    recorded, seed = record_of(policy, args.policy, args.out), args.training_seed
    if seed is not None and recorded.training_seed not in (None, seed):
        raise UsageError(
            f"--training-seed {seed}: {args.policy} records {recorded.training_seed}; leave the "
            "option out"
        )
    sources = args.learned_from
    stated = {
        "learned_from": None if sources is None else tuple(sources),
        "training_seed": seed,
        "test_evaluations": args.test_evaluations,
    }
    return replace(recorded, **{name: value for name, value in stated.items() if value is not None})


def _prepare_folder(args: argparse.Namespace, policy: str) -> None:
    """Make the folder, so that an unwritable one is noticed, and say which scores are replaced.

    Another policy's scores are not replaced, and a run folder gets only those of its own policy.
    """
    from magical.evaluation import read_entry
    from magical.files import make_folder
    from magical.runs import is_run

    owner, replaced = policy, ""
    with suppress(MagicalError, OSError):
        old = read_entry(args.out)
        owner = old.record.policy or policy
        replaced = (
            f"replaces the scores in {args.out}: {len(old.scores)} rollouts in "
            f"{len(old.evaluated.env_ids)} environments, nudge {old.evaluated.nudge:g}"
        )
    if is_run(args.out) and args.out.resolve() != Path(args.policy).resolve():
        owner = "the run in it"
    if owner != policy:
        raise UsageError(f"{args.out}: belongs to {quoted(owner)}; choose another folder")
    make_folder(args.out)
    if replaced:
        log(replaced)


def print_scores(scores: "Sequence[RolloutScore]") -> None:
    """Print a row for each environment, then the generalisation gap over all tasks."""
    from magical.evaluation import by_variant
    from magical.evaluation.statistics import gap_weights, over_rollouts, rollout_mean

    header = ("task", "variant", "mean", "95% interval", "std", "gap", "published code's rule")
    rows = []
    for task, cells in by_variant(scores).items():
        of_demo = np.mean([row.score for row in cells.get("Demo", [])] or [np.nan])
        for variant, cell in cells.items():
            rollouts = np.array([row.score for row in cell])
            value, low, high = rollout_mean(rollouts)
            published = np.mean([row.published_code_score for row in cell])
            gap = (
                ""
                if variant == "Demo" or np.isnan(of_demo)
                else decimals(float(of_demo) - value, 3)
            )
            interval, std = f"{low:.3f} to {high:.3f}", f"{rollouts.std():.3f}"
            rows.append((task, variant, f"{value:.3f}", interval, std, gap, f"{published:.3f}"))
    print_table(header, rows)
    env_ids = list(dict.fromkeys(row.env_id for row in scores))
    with suppress(ValueError):  # no task has both Demo and TestAll
        overall = over_rollouts([scores], env_ids, gap_weights(env_ids))
        mean, least, most = (decimals(number, 3) for number in overall)
        print(f"generalisation gap (Demo minus TestAll): {mean} ({least} to {most})")
    print("Intervals are over rollouts and do not include the spread between training runs.")
