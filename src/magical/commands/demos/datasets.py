"""`magical demos generate`, `info`, `replay`, `video`, `export`, `push` and `pull`."""

import argparse
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from magical.commands._common import UsageError, log, print_json, print_table
from magical.errors import DatasetError
from magical.messages import printable

if TYPE_CHECKING:
    from magical.demos import Problem
    from magical.demos.store.summary import DatasetSummary


def run_generate(args: argparse.Namespace) -> int:
    """`magical demos generate`."""
    from magical.demos import Dataset
    from magical.demos.generate import generate
    from magical.demos.store.summary import find_duplicates
    from magical.envs import parse_env_id
    from magical.progress import ProgressBar

    ids = [parse_env_id(env_id).without_preset for env_id in args.env]
    names = ("seed", "first", "perturb", "min_score", "action_space", "workers")
    options = {name: getattr(args, name) for name in names}
    try:
        with ProgressBar("generate", args.n * len(ids)) as bar:
            reports = [
                generate(env_id, args.n, args.out, progress=bar.advance, **options)
                for env_id in ids
            ]
    except KeyboardInterrupt:
        log(f"what was added to {args.out} stays there; --first continues a series")
        raise
    print_table(
        ("environment", "kept", "dropped", "mean score"),
        [(r.env_id, r.kept, r.dropped, f"{sum(r.scores) / r.kept:.3f}") for r in reports],
    )
    entries = Dataset.open(args.out).entries
    added = {entry.file for entry in entries[-sum(report.kept for report in reports) :]}
    if copies := sum(later in added for later, _ in find_duplicates(entries)):
        log(
            f"warning: {args.out}: demonstrations that duplicate earlier ones: {copies}; in the "
            "same scene, an expert repeats itself unless its actions are perturbed (--perturb); "
            "use another --seed for another series, or --first to continue one"
        )
    print_json(args, {"out": str(args.out), "environments": [asdict(report) for report in reports]})
    return 0


def run_info(args: argparse.Namespace) -> int:
    """`magical demos info`: exit status 1 if there are problems."""
    from magical.demos import Dataset
    from magical.demos.store.repair import repair
    from magical.demos.store.summary import find_duplicates, summarise_dataset

    if args.repair:
        for problem in repair(args.dataset):
            log(f"found: {problem}")
    dataset = Dataset.open(args.dataset, skip_damaged=True)
    summaries = summarise_dataset(dataset)
    duplicates = find_duplicates(dataset.entries)
    _print_summaries(summaries)
    for later, earlier in duplicates:
        log(f"duplicate: {printable(later)} shows the same episode as {printable(earlier)}")
    _log_problems(dataset.problems)
    print_json(
        args,
        {
            "count": len(dataset),
            "environments": [asdict(summary) for summary in summaries],
            "duplicates": duplicates,
            "problems": [asdict(problem) for problem in dataset.problems],
        },
    )
    return 1 if dataset.problems else 0


def _print_summaries(summaries: "Sequence[DatasetSummary]") -> None:
    columns = "environment", "count", "poses", "labels", "steps", "score", "published rule"
    rows = [
        (
            s.env_id,
            s.count,
            s.with_poses,
            s.with_expert_actions,
            f"{s.lengths[0]}-{s.lengths[2]}",
            _number(s.score),
            _number(s.published_code_score),
            f"{s.size / s.count / 1000:.0f}",
            printable(", ".join(s.demonstrators)),
        )
        for s in summaries
    ]
    print_table((*columns, "kB each", "by"), rows)
    print("labels: trajectories with expert actions in addition to the executed ones.\n")
    most = [
        (
            s.env_id,
            ", ".join(s.action_spaces),
            ", ".join(f"{name} {share:.0%}" for name, share in s.action_frequencies[:6]),
        )
        for s in summaries
    ]
    print_table(("environment", "action space", "actions, most frequent first"), most)


def run_replay(args: argparse.Namespace) -> int:
    """`magical demos replay`: exit status 1 if anything is damaged."""
    from magical.demos import Dataset
    from magical.demos.replay import mean_replays, replay
    from magical.progress import ProgressBar

    dataset = Dataset.open(args.dataset, skip_damaged=True)
    replays = []
    with ProgressBar("replay", len(dataset)) as bar:
        for entry, trajectory in zip(dataset.entries, dataset, strict=True):
            replays.append(replay(trajectory, entry.file))
            bar.advance()
    means = mean_replays(replays)
    columns = "environment", "count", "recorded", "replayed", "agree", "published", "appendix"
    rows = [
        (
            m.env_id,
            m.count,
            _number(m.recorded),
            _number(m.published_code_score),
            m.agree,
            "-" if m.published_replay is None else "{:.2f} to {:.2f}".format(*m.published_replay),
            _number(m.score),
            "-" if m.exact is None else m.exact,
        )
        for m in means
    ]
    agree = sum(mean.agree for mean in means)
    print_table((*columns, "exact"), rows)
    print(f"\n{agree} of {len(replays)} replays reproduced the recorded score.\n\n{_REPLAY_NOTE}")
    _log_problems(dataset.problems)
    print_json(
        args,
        {
            "agree": agree,
            "environments": [asdict(mean) for mean in means],
            "replays": [asdict(one) | {"agrees": one.agrees} for one in replays],
            "problems": [asdict(problem) for problem in dataset.problems],
        },
    )
    return 1 if dataset.problems else 0


_REPLAY_NOTE = """\
recorded, replayed, published: by the published code's rule; appendix: by the appendix's.
agree: replays that reproduced the recorded score, by both rules if both are recorded.
published: 25 human demonstrations replayed in the published implementation, unchanged
and with the robot's start moved by 1e-9. exact: replays that ended in the recorded poses."""


def run_video(args: argparse.Namespace) -> int:
    """`magical demos video`."""
    from magical.demos import Dataset
    from magical.demos.export.video import write_video

    dataset = Dataset.open(args.dataset)
    entries = {entry.index: entry for entry in dataset.entries}
    first = {entry.env_id: entry.index for entry in reversed(dataset.entries)}
    chosen = args.index or sorted(first.values())
    if not chosen or not entries.keys() >= set(chosen):
        wanted = next((f"number {i}" for i in chosen if i not in entries), "demonstrations")
        raise DatasetError(
            f"{args.dataset}: expected {wanted}, found {len(dataset)} demonstrations"
        )
    frames = write_video((dataset.read(entries[i]) for i in chosen), args.out)
    print(f"wrote {args.out}: {len(chosen)} demonstrations, {frames} frames")
    print_json(args, {"out": str(args.out), "count": len(chosen), "frames": frames})
    return 0


def run_export(args: argparse.Namespace) -> int:
    """`magical demos export`."""
    from magical.demos import Dataset

    given = {name: v for name in ("name", "preset") if (v := getattr(args, name)) is not None}
    if given and args.to != "minari":
        raise UsageError(f"{' '.join(f'--{name}' for name in given)}: not for --to {args.to}")
    dataset = Dataset.open(args.dataset, skip_damaged=args.skip_damaged)
    _log_problems(dataset.problems)
    result: dict[str, Any] = {"to": args.to}
    if args.to == "minari":
        from magical.demos.export.minari import export_minari

        result["datasets"] = export_minari(
            dataset, root=args.out, action_space=args.action_space, **given
        )
        print("\n".join(result["datasets"]))
    else:
        from magical.demos.export.lerobot import export_lerobot

        if args.out is None:
            raise UsageError("--out: expected a new folder for the LeRobot dataset, found none")
        frames = export_lerobot(dataset, args.out, args.action_space)
        result |= {"out": str(args.out), "frames": frames}
        print(f"wrote {args.out}: {len(dataset)} episodes, {result['frames']} frames")
    print_json(args, {**result, "episodes": len(dataset)})
    return 0


def run_push(args: argparse.Namespace) -> int:
    """`magical demos push`."""
    from magical.demos import Dataset
    from magical.demos.export.hub import push

    dataset = Dataset.open(args.dataset)
    address = push(dataset, args.repo, args.licence, private=args.private)
    print(f"pushed {len(dataset)} demonstrations to {address}")
    print_json(args, {"repository": address, "count": len(dataset)})
    return 0


def run_pull(args: argparse.Namespace) -> int:
    """`magical demos pull`."""
    from magical.demos.export.hub import pull

    dataset = pull(args.repo, args.out, args.revision)
    print(f"pulled {len(dataset)} demonstrations into {args.out}")
    print_json(args, {"out": str(args.out), "count": len(dataset)})
    return 0


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"


def _log_problems(problems: "Iterable[Problem]") -> None:
    for problem in problems:
        log(f"error: {problem}")
