"""Evaluate a policy with fixed seeds: 100 rollouts on each variant of each task.

POLICY is a run folder, `random`, `noop`, `expert`, or a policy of your own as `module:name` or
`file.py:name` (docs/own-policy.md).
"""

import argparse
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from statistics import fmean, pstdev

from magical.commands import _common as common
from magical.errors import MagicalError
from magical.evaluation import (
    Entry,
    Policy,
    Record,
    RolloutScore,
    by_variant,
    environments,
    load_policy,
    read_entry,
    summarise,
)
from magical.evaluation.entry import record_of
from magical.evaluation.protocol import MAX_NOISE, NUDGE, Evaluation
from magical.evaluation.rollouts import roll_out
from magical.evaluation.statistics import gap_weights, over_rollouts, rollout_mean
from magical.messages import decimals, quoted
from magical.processes import checked_workers
from magical.progress import ProgressBar
from magical.report.leaderboard import faults
from magical.runs import is_run

# Options that are recorded in the entry.
STATED = ("method", "leaderboard", "learned_from", "training_seed", "test_evaluations")


def configure(parser: argparse.ArgumentParser) -> None:
    meaning = (
        "a run folder, random, noop, expert, a plug-in's name, LOADER:PATH, module:name or "
        "file.py:name"
    )
    parser.add_argument("policy", metavar="POLICY", help=meaning)
    common.add_tasks(parser, "the policy's tasks, or all")
    meaning = "variants, such as Demo Jitter (default: all)"
    common.add_several(parser, "--variants", meaning, "VARIANT")
    common.add_rollouts(parser)
    meaning = (
        "control steps per episode (default: the paper's); `published`: 240 for the Cluster tasks"
    )
    parser.add_argument("--horizon", default="appendix", metavar="STEPS", help=meaning)
    meaning = (
        "shift initial poses randomly by up to X units and radians, seeded by the rollout's seed; "
        "1e-9 averages over effects of rounding"
    )
    common.add_number(parser, "--noise", meaning, default=None, most=MAX_NOISE)
    common.add_seed(parser, "which set of fixed seeds to use")
    meaning = "observation preset (default: the policy's own, or LoRes4E)"
    parser.add_argument("--observation", metavar="PRESET", help=meaning)
    common.add_workers(parser)
    common.add_out(parser, "folder to write scores.csv and entry.json to")
    parser.add_argument("--method", metavar="NAME", help="name in tables (default: POLICY's)")
    meaning = (
        "follow the leaderboard's protocol: use evaluation noise of 1e-9, and stop before any "
        "rollout if the entry would not be ranked"
    )
    parser.add_argument("--leaderboard", action="store_true", help=meaning)
    meaning = (
        'what the policy learned from, such as demonstrations or "rendered states"; not needed for '
        "run folders, which record it"
    )
    common.add_several(parser, "--learned-from", meaning, "SOURCE", nargs="*")
    meaning = "the training run's seed; run folders record it"
    common.add_count(parser, "--training-seed", meaning, least=0)
    meaning = "how often test variants were evaluated while the method was designed"
    common.add_count(parser, "--test-evaluations", meaning, least=0)
    common.add_json(parser)


def run(args: argparse.Namespace) -> int:
    for option in STATED:
        value = getattr(args, option)
        if not args.out and value is not None and value is not False:
            flag = f"--{option.replace('_', '-')}"
            raise common.UsageError(f"{flag} needs --out, which writes the entry")
    policy = load_policy(args.policy)
    own = getattr(policy, "observation", None)
    if args.observation and own not in (None, args.observation):
        raise common.UsageError(
            f"--observation {args.observation}: the policy states its own observation, {own}"
        )
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
        method = args.method or Path(args.policy).absolute().name  # also of "."
        entry = Entry.of(policy, evaluation, method=method, record=_record(args, policy))
        if args.leaderboard and (why := faults(entry)):
            what = "--leaderboard: the entry would not be ranked"
            raise common.UsageError(f"{what}: {'; '.join(why)}")
        _check_folder(args, entry)
    done, planned = getattr(policy, "updates", None) or (0, 0)
    if done < planned:
        common.log(
            f"warning: {args.policy}: training is unfinished: {done} of {planned} updates are "
            "done; magical train with --resume continues it"
        )
    with ProgressBar("rollouts", len(evaluation.env_ids) * args.rollouts) as bar:
        workers = checked_workers(args.workers)
        scores = roll_out(policy, evaluation, workers=workers, progress=bar.advance)
    print_scores(scores)
    if args.out:
        replace(entry, scores=scores).write(args.out)
        common.log(f"wrote scores.csv and entry.json to {args.out}")
    unfinished = {"unfinished": {"done": done, "planned": planned}} if done < planned else {}
    common.print_json(args, summarise(scores) | unfinished)
    return 0


def _record(args: argparse.Namespace, policy: Policy) -> Record:
    """What the entry states about the policy: what it records, and the options."""
    recorded, seed = record_of(policy, args.policy, args.out), args.training_seed
    if seed is not None and recorded.training_seed not in (None, seed):
        raise common.UsageError(
            f"--training-seed {seed}: {args.policy} records {recorded.training_seed}; leave the "
            "option out"
        )
    sources = None if args.learned_from is None else tuple(args.learned_from)
    stated = {"learned_from": sources, "training_seed": seed}
    stated["test_evaluations"] = args.test_evaluations
    return replace(recorded, **{name: value for name, value in stated.items() if value is not None})


def _check_folder(args: argparse.Namespace, entry: Entry) -> None:
    """Make the folder and say what is replaced; `UsageError` if it is another policy's."""
    owner, replaced = entry.record.policy, ""
    with suppress(MagicalError, OSError):
        old = read_entry(args.out)
        owner, how = old.record.policy or owner, old.evaluated
        replaced = f"{len(old.scores)} rollouts in {len(how.env_ids)} environments"
        replaced = f"replaces the scores in {args.out}: {replaced}, nudge {how.nudge:g}"
    if is_run(args.out) and args.out.resolve() != Path(args.policy).resolve():
        owner = "the run in it"
    if owner != entry.record.policy:
        raise common.UsageError(f"{args.out}: belongs to {quoted(owner)}; choose another folder")
    args.out.mkdir(parents=True, exist_ok=True)
    if replaced:
        common.log(replaced)


def print_scores(scores: Sequence[RolloutScore]) -> None:
    """Print a row for each environment, then the generalisation gap over all tasks."""
    rows = []
    for task, cells in by_variant(scores).items():
        means = {variant: fmean(row.score for row in cell) for variant, cell in cells.items()}
        for variant, cell in cells.items():
            value, low, high = rollout_mean([row.score for row in cell])
            gap = means["Demo"] - value if "Demo" in means and variant != "Demo" else None
            rows.append(
                {
                    "task": task,
                    "variant": variant,
                    "mean": value,
                    "95% interval": f"{low:.3f} to {high:.3f}",
                    "std": pstdev(row.score for row in cell),
                    "gap": "" if gap is None else decimals(gap, 3),
                    "published code's rule": fmean(row.published_code_score for row in cell),
                }
            )
    common.print_records(rows)
    env_ids = list(dict.fromkeys(row.env_id for row in scores))
    with suppress(ValueError):  # no task has both Demo and TestAll
        overall = over_rollouts([scores], env_ids, gap_weights(env_ids))
        mean, least, most = (decimals(number, 3) for number in overall)
        print(f"generalisation gap (Demo minus TestAll): {mean} ({least} to {most})")
    print("Intervals are over rollouts and do not include the spread between training runs.")
