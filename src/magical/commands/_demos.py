"""What the sub-commands of `magical demos` do."""

import argparse
import fnmatch
import shutil
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from magical.commands._common import log, print_json, print_table
from magical.errors import DatasetError, DownloadError

if TYPE_CHECKING:
    from magical.demos import Dataset, Problem
    from magical.demos.human.importing import ImportReport


def run_import(args: argparse.Namespace) -> int:
    """`magical demos import`."""
    from magical.demos.human.importing import find_published

    return _import(find_published(args.source), args, args.max_unpacked << 20)


def run_download(args: argparse.Namespace) -> int:
    """`magical demos download`: fetch what the dataset lacks, import it, remove the archive."""
    from magical.demos import Dataset, DatasetWriter
    from magical.demos.human.download import BASE_URL, fetch_all
    from magical.demos.human.published import MAX_UNPACKED, published_sums
    from magical.progress import progress_bar

    wanted = {f: s for f, s in published_sums().items() if fnmatch.fnmatch(f, args.files)}
    if not wanted:
        raise DownloadError(
            f"--files {args.files}: expected some of the published files, found none"
        )
    DatasetWriter(args.out)
    have = {(e.source, e.source_sha256) for e in Dataset.open(args.out).entries}
    missing = {f: s for f, s in wanted.items() if (Path(f).name, s) not in have}
    folder = args.keep or args.out / "download"
    with progress_bar("download", len(missing)) as advance:
        failed = fetch_all(missing, folder, args.base_url or BASE_URL, advance)
    for error in failed:
        log(f"error: {error}")
    files = [folder / name for name in missing if (folder / name).is_file()]
    status = _import(files, args, MAX_UNPACKED, not_fetched=[str(error) for error in failed])
    if not (args.keep or failed or status):
        shutil.rmtree(folder, ignore_errors=True)
    return 1 if failed else status


def run_generate(args: argparse.Namespace) -> int:
    """`magical demos generate`."""
    from magical.demos.generate import generate
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
                skill=args.skill,
                min_score=args.min_score,
                workers=args.workers,
                progress=advance,
            )
            reports.append(report)
    print_table(
        ("environment", "kept", "dropped", "mean score"),
        [(r.env_id, r.kept, r.dropped, f"{sum(r.scores) / r.kept:.3f}") for r in reports],
    )
    if args.json:
        print_json({"out": str(args.out), "environments": [asdict(report) for report in reports]})
    return 0


def run_info(args: argparse.Namespace) -> int:
    """`magical demos info`: exit status 1 if anything is wrong."""
    from magical.demos import Dataset
    from magical.demos.store.repair import repair
    from magical.demos.store.summary import find_duplicates, summarise_dataset

    if args.repair:
        for problem in repair(args.dataset):
            log(f"left out: {problem}")
    dataset = Dataset.open(args.dataset, skip_damaged=True)
    summaries = summarise_dataset(dataset)
    duplicates = find_duplicates(dataset.entries)
    header = ("environment", "count", "poses", "steps", "score", "published rule", "kB each", "by")
    rows = [
        (
            s.env_id,
            s.count,
            s.with_poses,
            f"{s.lengths[0]}-{s.lengths[2]}",
            _number(s.score),
            _number(s.published_code_score),
            f"{s.size / s.count / 1000:.0f}",
            ", ".join(s.demonstrators),
        )
        for s in summaries
    ]
    print_table(header, rows)
    print()
    print_table(
        ("environment", "actions, most frequent first"),
        [
            (s.env_id, ", ".join(f"{name} {share:.0%}" for name, share in s.usual_actions[:6]))
            for s in summaries
        ],
    )
    for later, earlier in duplicates:
        log(f"duplicate: {later} shows the same as {earlier}")
    _log_problems(dataset.problems)
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
    header = ("environment", "count", "recorded", "replayed", "published", "appendix", "exact")
    rows = [
        (
            m.env_id,
            m.count,
            _number(m.recorded),
            _number(m.published_code_score),
            "-" if m.published_replay is None else "{:.2f} to {:.2f}".format(*m.published_replay),
            _number(m.score),
            "-" if m.exact is None else m.exact,
        )
        for m in means
    ]
    print_table(header, rows)
    print()
    print(
        "recorded, replayed, published: by the published code's rule; appendix: by the appendix's."
    )
    print("published: 25 human demonstrations replayed in the published implementation, as they")
    print("are and with the robot's start moved by 1e-9. exact: ended in the recorded poses.")
    _log_problems(dataset.problems)
    if args.json:
        print_json(
            {
                "environments": [asdict(mean) for mean in means],
                "replays": [asdict(one) for one in replays],
                "problems": [asdict(problem) for problem in dataset.problems],
            }
        )
    return 1 if dataset.problems else 0


def run_video(args: argparse.Namespace) -> int:
    """`magical demos video`."""
    from magical.demos import Dataset
    from magical.demos.export.video import write_video

    dataset = Dataset.open(args.dataset)
    chosen = args.index if args.index is not None else _first_of_each(dataset)
    if not chosen or max(chosen) >= len(dataset):
        raise DatasetError(f"{args.dataset}: expected demonstration {chosen}, found {len(dataset)}")
    frames = write_video((dataset[i] for i in chosen), args.out, args.rate)
    print(f"wrote {args.out}: {len(chosen)} demonstrations, {frames} frames")
    return 0


def run_export(args: argparse.Namespace) -> int:
    """`magical demos export`."""
    from magical.demos import Dataset

    dataset = Dataset.open(args.dataset, skip_damaged=args.skip_damaged)
    _log_problems(dataset.problems)
    if args.to == "minari":
        from magical.demos.export.minari import export_minari

        names = export_minari(dataset, args.name, args.preset, args.out)
        print("\n".join(names))
        result: dict[str, object] = {"to": "minari", "datasets": names}
    else:
        from magical.demos.export.lerobot import export_lerobot

        if args.out is None:
            raise DatasetError("--out: expected a new folder for the LeRobot dataset, found none")
        frames = export_lerobot(dataset, args.out)
        print(f"wrote {args.out}: {len(dataset)} episodes, {frames} frames")
        result = {"to": "lerobot", "out": str(args.out), "frames": frames}
    if args.json:
        print_json({**result, "episodes": len(dataset)})
    return 0


def _import(
    files: list[Path],
    args: argparse.Namespace,
    max_bytes: int,
    not_fetched: list[str] | None = None,
) -> int:
    from magical.demos.human.importing import import_published
    from magical.progress import progress_bar

    with progress_bar("import", len(files)) as advance:
        report = import_published(
            files,
            args.out,
            workers=args.workers,
            max_bytes=max_bytes,
            skip_duplicates=args.skip_duplicates,
            progress=advance,
        )
    _print_import(report, args.out)
    if args.json:
        print_json({"out": str(args.out), "not_fetched": not_fetched or [], **asdict(report)})
    return 1 if report.failed else 0


def _print_import(report: "ImportReport", out: Path) -> None:
    print(f"imported {len(report.imported)} demonstrations into {out}")
    if report.already:
        print(f"{len(report.already)} were there already")
    for later, earlier in report.duplicates:
        log(f"duplicate: {later} shows the same as {earlier}")
    for _, why in report.failed:
        log(f"error: {why}")


def _first_of_each(dataset: "Dataset") -> list[int]:
    first: dict[str, int] = {}
    for i, entry in enumerate(dataset.entries):
        first.setdefault(entry.env_id, i)
    return list(first.values())


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"


def _log_problems(problems: "tuple[Problem, ...]") -> None:
    for problem in problems:
        log(f"error: {problem}")
