"""Demonstrations: import the human ones, generate, inspect, replay, render, export and share.

A dataset DIR is a folder with one .npz file for each demonstration.
"""

import argparse
import fnmatch
import os
import shutil
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path

from magical.commands._common import (
    add_count,
    add_json,
    add_number,
    add_out,
    add_seed,
    add_several,
    add_workers,
    log,
    number,
    print_json,
    print_table,
)
from magical.errors import DatasetError, DownloadError
from magical.messages import printable

HELP = "demonstrations: import, generate, replay, export, push"
ARCHIVE = "https://github.com/qxcv/magical-data"
DATASET = "dataset to create or append to"
POSITIONAL: dict[str, tuple[type, str, str]] = {
    "source": (Path, "SRC", "a folder with *.pkl.gz files, or one such file"),
    "dataset": (Path, "DIR", "the dataset's folder"),
    "repo": (str, "OWNER/NAME", "the dataset repository"),
}

Run = Callable[[argparse.Namespace], int]


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the sub-commands and their arguments."""
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)

    def add(name: str, run_demos: Run, meaning: str, *words: str) -> argparse.ArgumentParser:
        command = commands.add_parser(name, help=meaning)
        command.set_defaults(run_demos=run_demos)
        for word in words:
            positional, metavar, described = POSITIONAL[word]
            command.add_argument(word, type=positional, metavar=metavar, help=described)
        add_json(command)
        return command

    _importing(add("import", run_import, "import published human demonstrations", "source"))
    download = add("download", run_download, f"download and import {ARCHIVE}")
    download.add_argument("--base-url", metavar="URL", help=f"use it instead of {ARCHIVE}")
    meaning = "download only the files that match, such as 'move-to-corner/*'"
    download.add_argument("--files", default="*", metavar="PATTERN", help=meaning)
    meaning = "keep the downloaded files in this folder"
    download.add_argument("--keep", type=Path, metavar="FOLDER", help=meaning)
    _importing(download)
    _generate(add("generate", run_generate, "roll out the scripted experts"))
    add("info", run_info, "show what a dataset contains", "dataset")
    meaning = "resimulate the recorded actions and score the result"
    add("replay", run_replay, meaning, "dataset")
    video = add("video", run_video, "make a video, with both views side by side", "dataset")
    add_out(video, "video to write, FILE.mp4", "FILE", required=True)
    meaning = "numbers of the demonstrations, from 0 (default: the first of each environment)"
    add_several(video, "--index", meaning, "I", kind=number(int, 0))
    export = add("export", run_export, "export a dataset to Minari", "dataset")
    export.add_argument("--to", choices=("minari",), required=True, help="target format")
    add_out(export, "the folder of Minari's datasets (default: Minari's own)", "FOLDER")
    export.add_argument("--name", default="demos", help="last part of the id (default: demos)")
    meaning = "observation preset (default: LoRes4E)"
    export.add_argument("--preset", default="LoRes4E", help=meaning)
    push = add("push", run_push, "upload a dataset to the Hugging Face Hub", "dataset", "repo")
    meaning = "licence identifier of the Hub, such as cc-by-4.0"
    push.add_argument("--licence", "--license", required=True, metavar="ID", help=meaning)
    push.add_argument("--private", action="store_true", help="make a new repository private")
    pull = add("pull", run_pull, "download a dataset from the Hugging Face Hub", "repo")
    add_out(pull, "new folder to download into", "DIR", required=True)
    pull.add_argument("--revision", metavar="REV", help="a branch, tag or commit")


def _importing(parser: argparse.ArgumentParser) -> None:
    add_out(parser, DATASET, required=True)
    meaning = "import demonstrations that are in several files only once"
    parser.add_argument("--skip-duplicates", action="store_true", help=meaning)
    add_workers(parser)


def _generate(parser: argparse.ArgumentParser) -> None:
    add_several(parser, "--env", "environment ids", "ID", required=True)
    add_count(parser, "-n", "demonstrations in each environment", default=25)
    add_out(parser, DATASET, required=True)
    add_seed(parser, "seed of the scenes and of the experts' strategies")
    meaning = "number of the first attempt, to continue a series"
    add_count(parser, "--first", meaning, default=0, least=0, metavar="K")
    add_number(parser, "--min-score", "discard demonstrations that score less", most=1)
    meaning = (
        "share of steps, 0 to 1, in which a random action replaces the expert's; learners still "
        "imitate the expert's"
    )
    add_number(parser, "--perturb", meaning, most=1, metavar="P")
    add_workers(parser)


def run(args: argparse.Namespace) -> int:
    """Run the chosen sub-command."""
    return int(args.run_demos(args))


def _workers(args: argparse.Namespace) -> int:
    return (os.cpu_count() or 1) if args.workers is None else max(1, args.workers)


def run_import(args: argparse.Namespace) -> int:
    """`magical demos import`."""
    from magical.demos.human import find_published

    return _import_files(find_published(args.source), args)


def run_download(args: argparse.Namespace) -> int:
    """`magical demos download`: fetch what the dataset lacks, import it, remove the files."""
    from magical.demos import Dataset, DatasetWriter
    from magical.demos.human import BASE_URL, download, published_sums
    from magical.progress import ProgressBar

    wanted = {f: s for f, s in published_sums().items() if fnmatch.fnmatch(f, args.files)}
    if not wanted:
        raise DownloadError(
            f"--files {args.files}: expected a pattern that published files match, found no match"
        )
    DatasetWriter(args.out)
    have = {entry.name for entry in Dataset.open(args.out).entries}
    missing = {f: s for f, s in wanted.items() if Path(f).name not in have}
    folder = args.keep or args.out / "download"
    with ProgressBar("download", len(missing)) as bar:
        files, errors = download(missing, folder, args.base_url or BASE_URL, bar.advance)
    for error in errors:
        log(f"error: {error}")
    status = _import_files(files, args, not_fetched=errors)
    if not (args.keep or errors or status):
        shutil.rmtree(folder, ignore_errors=True)
    return 1 if errors else status


def _import_files(
    files: list[Path], args: argparse.Namespace, not_fetched: Sequence[str] = ()
) -> int:
    from magical.demos.human import import_published
    from magical.progress import ProgressBar

    with ProgressBar("import", len(files)) as bar:
        report = import_published(
            files,
            args.out,
            workers=_workers(args),
            skip_duplicates=args.skip_duplicates,
            progress=bar.advance,
        )
    print(f"imported {len(report.imported)} demonstrations into {args.out}")
    if report.already:
        print(f"{len(report.already)} were already there")
    _log_duplicates(report.duplicates)
    for _, reason in report.failed:
        log(f"error: {reason}")
    print_json(args, {"out": str(args.out), "not_fetched": list(not_fetched), **asdict(report)})
    return 1 if report.failed else 0


def run_generate(args: argparse.Namespace) -> int:
    """`magical demos generate`."""
    from magical.demos import Dataset
    from magical.demos.generate import generate
    from magical.envs import parse_env_id
    from magical.progress import ProgressBar

    ids = [parse_env_id(env_id).without_preset for env_id in args.env]
    names = ("seed", "first", "perturb", "min_score")
    options = {name: getattr(args, name) for name in names} | {"workers": _workers(args)}
    with ProgressBar("generate", args.n * len(ids)) as bar:
        reports = [
            generate(env_id, args.n, args.out, progress=bar.advance, **options) for env_id in ids
        ]
    print_table(
        ("environment", "demonstrations", "already there", "dropped", "mean score"),
        [
            (r.env_id, len(r.scores), r.already, r.dropped, _number(sum(r.scores) / args.n))
            for r in reports
        ],
    )
    if copies := Dataset.open(args.out).duplicates():
        log(
            f"warning: {args.out}: demonstrations that duplicate earlier ones: {len(copies)}; in "
            "the same scene, an expert repeats itself unless its actions are perturbed (--perturb)"
        )
    print_json(args, {"out": str(args.out), "environments": [asdict(report) for report in reports]})
    return 0


def run_info(args: argparse.Namespace) -> int:
    """`magical demos info`."""
    from magical.demos import Dataset
    from magical.demos.dataset import summarise

    dataset = Dataset.open(args.dataset)
    summaries, duplicates = summarise(dataset.entries), dataset.duplicates()
    columns = "environment", "count", "poses", "labels", "steps", "score", "published rule"
    rows = [
        (
            *(s[name] for name in ("env_id", "count", "with_poses", "with_labels")),
            "-".join(map(str, s["lengths"])),
            _number(s["score"]),
            _number(s["published_code_score"]),
            f"{s['bytes'] / s['count'] / 1000:.0f}",
            ", ".join(s["action_spaces"]),
            printable(", ".join(s["demonstrators"])),
        )
        for s in summaries
    ]
    print_table((*columns, "kB each", "actions", "by"), rows)
    print("labels: trajectories with expert actions in addition to the executed ones.")
    _log_duplicates(duplicates)
    plain = {"count": len(dataset), "environments": summaries, "duplicates": duplicates}
    print_json(args, plain)
    return 0


def run_replay(args: argparse.Namespace) -> int:
    """`magical demos replay`."""
    from magical.demos import Dataset
    from magical.demos.trajectory import replay
    from magical.progress import ProgressBar

    dataset, replays = Dataset.open(args.dataset), []
    with ProgressBar("replay", len(dataset)) as bar:
        for entry, trajectory in zip(dataset.entries, dataset, strict=True):
            recorded = {"env_id": str(entry.env_id), "recorded": entry.published_code_score}
            replays.append({"file": entry.file, **recorded, **asdict(replay(trajectory))})
            bar.advance()
    rows = []
    for env_id in sorted({one["env_id"] for one in replays}):
        group = [one for one in replays if one["env_id"] == env_id]
        means = [
            _number(sum(one[name] for one in group) / len(group))
            for name in ("recorded", "published_code_score", "score")
        ]
        exact = sum(one["departure"] == 0.0 for one in group)
        rows.append((env_id, len(group), *means, sum(one["agrees"] for one in group), exact))
    columns = "environment", "count", "recorded", "replayed", "appendix", "agree", "exact"
    print_table(columns, rows)
    agree = sum(one["agrees"] for one in replays)
    print(f"\n{agree} of {len(replays)} replays reproduced the recorded score.\n\n{_REPLAY_NOTE}")
    print_json(args, {"agree": agree, "replays": replays})
    return 0


_REPLAY_NOTE = """\
recorded, replayed: by the published code's rule; appendix: replayed, by the appendix's.
agree: replays that reproduced the recorded score, by both rules if both are recorded.
exact: replays that ended in the recorded poses."""


def run_video(args: argparse.Namespace) -> int:
    """`magical demos video`."""
    from magical.demos import Dataset
    from magical.demos.export import write_video

    dataset = Dataset.open(args.dataset)
    first = {entry.env_id: i for i, entry in reversed(list(enumerate(dataset.entries)))}
    chosen = args.index or sorted(first.values())
    if not chosen or max(chosen) >= len(dataset):
        wanted = f"number {max(chosen)}" if chosen else "demonstrations"
        raise DatasetError(
            f"{args.dataset}: expected {wanted}, found {len(dataset)} demonstrations"
        )
    frames = write_video((dataset[i] for i in chosen), args.out)
    print(f"wrote {args.out}: {len(chosen)} demonstrations, {frames} frames")
    print_json(args, {"out": str(args.out), "count": len(chosen), "frames": frames})
    return 0


def run_export(args: argparse.Namespace) -> int:
    """`magical demos export`."""
    from magical.demos import Dataset
    from magical.demos.export import export_minari

    if args.out is not None:
        args.out.mkdir(parents=True, exist_ok=True)
        os.environ["MINARI_DATASETS_PATH"] = str(args.out.resolve())
    dataset = Dataset.open(args.dataset)
    made = export_minari(dataset, args.name, args.preset)
    print("\n".join(made))
    print_json(args, {"to": args.to, "datasets": made, "episodes": len(dataset)})
    return 0


def run_push(args: argparse.Namespace) -> int:
    """`magical demos push`."""
    from magical.demos import Dataset
    from magical.demos.export import push

    dataset = Dataset.open(args.dataset)
    address = push(dataset, args.repo, args.licence, private=args.private)
    print(f"pushed {len(dataset)} demonstrations to {address}")
    print_json(args, {"repository": address, "count": len(dataset)})
    return 0


def run_pull(args: argparse.Namespace) -> int:
    """`magical demos pull`."""
    from magical.demos.export import pull

    dataset = pull(args.repo, args.out, args.revision)
    print(f"pulled {len(dataset)} demonstrations into {args.out}")
    print_json(args, {"out": str(args.out), "count": len(dataset)})
    return 0


def _log_duplicates(duplicates: Sequence[tuple[str, str]]) -> None:
    for later, earlier in duplicates:
        log(f"duplicate: {printable(later)} shows the same episode as {printable(earlier)}")


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"
