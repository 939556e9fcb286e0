"""`magical demos info` and `magical demos replay`: the content of a dataset."""

import argparse
from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING

from magical.commands._common import add_json, log, print_json, print_table
from magical.commands.demos._shared import (
    Subparsers,
    add_command,
    add_dataset,
    log_problems,
    names,
    number,
)
from magical.messages import printable

if TYPE_CHECKING:
    from magical.demos.store.summary import DatasetSummary


def add_commands(subparsers: Subparsers) -> None:
    """Add both sub-commands."""
    parser = add_command(subparsers, "info", run_info, "the content of a dataset, and its problems")
    add_dataset(parser)
    parser.add_argument(
        "--repair", action="store_true", help="rebuild the manifest from the intact trajectories"
    )
    add_json(parser)
    parser = add_command(
        subparsers, "replay", run_replay, "simulate the recorded actions again and score the result"
    )
    add_dataset(parser)
    add_json(parser)


def run_info(args: argparse.Namespace) -> int:
    """`magical demos info`: exit status 1 if there are problems."""
    from magical.demos import Dataset
    from magical.demos.store.repair import repair
    from magical.demos.store.summary import find_duplicates, summarise_dataset

    if args.repair:
        for problem in repair(args.dataset):
            log(f"left out: {problem}")
    dataset = Dataset.open(args.dataset, skip_damaged=True)
    summaries = summarise_dataset(dataset)
    duplicates = find_duplicates(dataset.entries)
    _print_summaries(summaries)
    for later, earlier in duplicates:
        log(f"duplicate: {printable(later)} shows the same as {printable(earlier)}")
    log_problems(dataset.problems)
    if args.json:
        print_json(
            {
                "count": len(dataset),
                "environments": [asdict(summary) for summary in summaries],
                "duplicates": duplicates,
                "problems": [asdict(problem) for problem in dataset.problems],
            }
        )
    return 1 if dataset.problems else 0


def _print_summaries(summaries: "Sequence[DatasetSummary]") -> None:
    header = (
        "environment",
        "count",
        "poses",
        "labels",
        "steps",
        "score",
        "published rule",
        "kB each",
        "by",
    )
    rows = [
        (
            s.env_id,
            s.count,
            s.with_poses,
            s.with_expert_actions,
            f"{s.lengths[0]}-{s.lengths[2]}",
            number(s.score),
            number(s.published_code_score),
            f"{s.size / s.count / 1000:.0f}",
            names(s.demonstrators),
        )
        for s in summaries
    ]
    print_table(header, rows)
    print("labels: trajectories with expert actions beside those that were executed.")
    print()
    print_table(
        ("environment", "actions, most frequent first"),
        [
            (s.env_id, ", ".join(f"{name} {share:.0%}" for name, share in s.action_frequencies[:6]))
            for s in summaries
        ],
    )


def run_replay(args: argparse.Namespace) -> int:
    """`magical demos replay`: exit status 1 if anything is damaged."""
    from magical.demos import Dataset
    from magical.demos.replay import mean_replays, replay
    from magical.progress import progress_bar

    dataset = Dataset.open(args.dataset, skip_damaged=True)
    replays = []
    with progress_bar("replay", len(dataset)) as advance:
        for entry, trajectory in zip(dataset.entries, dataset, strict=True):
            replays.append(replay(trajectory, entry.file))
            advance(1)
    means = mean_replays(replays)
    header = (
        "environment", "count", "recorded", "replayed", "agree", "published", "appendix", "exact"
    )  # fmt: skip
    rows = [
        (
            m.env_id,
            m.count,
            number(m.recorded),
            number(m.published_code_score),
            m.agree,
            "-" if m.published_replay is None else "{:.2f} to {:.2f}".format(*m.published_replay),
            number(m.score),
            "-" if m.exact is None else m.exact,
        )
        for m in means
    ]
    agree = sum(mean.agree for mean in means)
    print_table(header, rows)
    print(f"\n{agree} of {len(replays)} replays got the recorded score.\n\n{_REPLAY_NOTE}")
    log_problems(dataset.problems)
    if args.json:
        print_json(
            {
                "agree": agree,
                "environments": [asdict(mean) for mean in means],
                "replays": [asdict(one) | {"agrees": one.agrees} for one in replays],
                "problems": [asdict(problem) for problem in dataset.problems],
            }
        )
    return 1 if dataset.problems else 0


_REPLAY_NOTE = """\
recorded, replayed, published: by the published code's rule; appendix: by the appendix's.
agree: replays that got the recorded score, by both rules where both are recorded.
published: 25 human demonstrations replayed in the published implementation, unchanged
and with the robot's start moved by 1e-9. exact: ended in the recorded poses."""
