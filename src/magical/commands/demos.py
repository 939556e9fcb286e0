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
from statistics import fmean

from magical.commands import _common as common
from magical.errors import DatasetError, DownloadError

HELP = "demonstrations: import, generate, replay, export, push"
ARCHIVE = "https://github.com/qxcv/magical-data"
DATASET = "dataset to create or append to"
POSITIONAL: dict[str, tuple[type, str, str]] = {
    "source": (Path, "SRC", "a folder with *.pkl.gz files, or one such file"),
    "dataset": (Path, "DIR", "the dataset's folder"),
    "repo": (str, "OWNER/NAME", "the dataset repository"),
}

Args = argparse.Namespace


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the sub-commands and their arguments."""
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)

    def add(
        function: Callable[[Args], int], meaning: str, *positionals: str
    ) -> argparse.ArgumentParser:
        command = commands.add_parser(function.__name__.strip("_"), help=meaning)
        command.set_defaults(run_demos=function)
        for name in positionals:
            kind, metavar, described = POSITIONAL[name]
            command.add_argument(name, type=kind, metavar=metavar, help=described)
        common.add_json(command)
        return command

    import_command = add(import_, "import published human demonstrations", "source")
    command = add(download, f"download and import {ARCHIVE}")
    command.add_argument("--base-url", metavar="URL", help=f"use it instead of {ARCHIVE}")
    meaning = "download only the files that match, such as 'move-to-corner/*'"
    command.add_argument("--files", default="*", metavar="PATTERN", help=meaning)
    meaning = "keep the downloaded files in this folder"
    command.add_argument("--keep", type=Path, metavar="FOLDER", help=meaning)
    for importing in (import_command, command):
        common.add_out(importing, DATASET, required=True)
        meaning = "import demonstrations that are in several files only once"
        importing.add_argument("--skip-duplicates", action="store_true", help=meaning)
        common.add_workers(importing)
    command = add(generate, "roll out the scripted experts")
    common.add_several(command, "--env", "environment ids", "ID", required=True)
    common.add_count(command, "-n", "demonstrations in each environment", default=25)
    common.add_out(command, DATASET, required=True)
    common.add_seed(command, "seed of the scenes and of the experts' strategies")
    meaning = "number of the first attempt, to continue a series"
    common.add_count(command, "--first", meaning, default=0, least=0, metavar="K")
    common.add_number(command, "--min-score", "discard demonstrations that score less", most=1)
    meaning = (
        "share of steps, 0 to 1, in which a random action replaces the expert's; learners still "
        "imitate the expert's"
    )
    common.add_number(command, "--perturb", meaning, most=1)
    common.add_workers(command)
    add(info, "show what a dataset contains", "dataset")
    add(replay, "resimulate the recorded actions and score the result", "dataset")
    command = add(video, "make a video, with both views side by side", "dataset")
    common.add_out(command, "video to write, FILE.mp4", "FILE", required=True)
    meaning = "numbers of the demonstrations, from 0 (default: the first of each environment)"
    common.add_several(command, "--index", meaning, "I", kind=int)
    command = add(export, "export a dataset to Minari", "dataset")
    command.add_argument("--to", choices=("minari",), required=True, help="target format")
    common.add_out(command, "the folder of Minari's datasets (default: Minari's own)", "FOLDER")
    command.add_argument("--name", default="demos", help="last part of the id (default: demos)")
    meaning = "observation preset (default: LoRes4E)"
    command.add_argument("--preset", default="LoRes4E", help=meaning)
    command = add(push, "upload a dataset to the Hugging Face Hub", "dataset", "repo")
    meaning = "licence identifier of the Hub, such as cc-by-4.0"
    command.add_argument("--licence", "--license", required=True, metavar="ID", help=meaning)
    command.add_argument("--private", action="store_true", help="make a new repository private")
    command = add(pull, "download a dataset from the Hugging Face Hub", "repo")
    common.add_out(command, "new folder to download into", required=True)
    command.add_argument("--revision", metavar="REV", help="a branch, tag or commit")


def run(args: Args) -> int:
    """Run the chosen sub-command."""
    return int(args.run_demos(args))


def import_(args: Args) -> int:
    """Import published files."""
    from magical.demos.human import find_published

    return _import(find_published(args.source), args)


def download(args: Args) -> int:
    """Fetch what the dataset lacks, import it, remove the files."""
    from magical.demos import Dataset, DatasetWriter, human
    from magical.progress import ProgressBar

    sums = human.published_sums().items()
    wanted = {file: digest for file, digest in sums if fnmatch.fnmatch(file, args.files)}
    if not wanted:
        raise DownloadError(f"--files {args.files}: expected a pattern that published files match")
    DatasetWriter(args.out)
    have = {entry.name for entry in Dataset.open(args.out).entries}
    lacking = {file: digest for file, digest in wanted.items() if Path(file).name not in have}
    folder = args.keep or args.out / "download"
    with ProgressBar("download", len(lacking)) as bar:
        url = args.base_url or human.BASE_URL
        files, errors = human.download(lacking, folder, url, bar.advance)
    for error in errors:
        common.log(f"error: {error}")
    status = _import(files, args, errors)
    if not (args.keep or errors or status):
        shutil.rmtree(folder, ignore_errors=True)
    return 1 if errors else status


def _import(files: list[Path], args: Args, not_fetched: Sequence[str] = ()) -> int:
    from magical.demos.human import import_published
    from magical.progress import ProgressBar

    skip = args.skip_duplicates
    with ProgressBar("import", len(files)) as bar:
        report = import_published(
            files, args.out, workers=_workers(args), skip_duplicates=skip, progress=bar.advance
        )
    print(f"imported {len(report.imported)} demonstrations into {args.out}")
    if report.already:
        print(f"{len(report.already)} were already there")
    _log_duplicates(report.duplicates)
    for _, reason in report.failed:
        common.log(f"error: {reason}")
    result = {"out": str(args.out), "not_fetched": list(not_fetched), **asdict(report)}
    common.print_json(args, result)
    return 1 if report.failed else 0


def _workers(args: Args) -> int:
    return (os.cpu_count() or 1) if args.workers is None else max(1, args.workers)


def generate(args: Args) -> int:
    """Roll out the experts."""
    from magical.demos import Dataset
    from magical.demos import generate as demonstrations
    from magical.envs import parse_env_id
    from magical.progress import ProgressBar

    ids = [parse_env_id(env_id).without_preset for env_id in args.env]
    names = ("seed", "first", "perturb", "min_score")
    options = {name: getattr(args, name) for name in names} | {"workers": _workers(args)}
    reports = []
    with ProgressBar("generate", args.n * len(ids)) as bar:
        for env_id in ids:
            options["progress"] = bar.advance
            report = demonstrations.generate(env_id, args.n, args.out, **options)
            reports.append(asdict(report))
    common.print_records([{**report, "scores": fmean(report["scores"])} for report in reports])
    if copies := Dataset.open(args.out).duplicates():
        common.log(
            f"warning: {args.out}: demonstrations that duplicate earlier ones: {len(copies)}; in "
            "the same scene, an expert repeats itself unless its actions are perturbed (--perturb)"
        )
    common.print_json(args, {"out": str(args.out), "environments": reports})
    return 0


def info(args: Args) -> int:
    """Print what is in a dataset."""
    from magical.demos import Dataset
    from magical.demos.summary import summarise

    dataset = Dataset.open(args.dataset)
    summaries, duplicates = summarise(dataset.entries), dataset.duplicates()
    common.print_records(summaries)
    _log_duplicates(duplicates)
    plain = {"count": len(dataset), "environments": summaries, "duplicates": duplicates}
    common.print_json(args, plain)
    return 0


def replay(args: Args) -> int:
    """Simulate every demonstration again."""
    from magical.demos import Dataset, summary
    from magical.grouping import group_by
    from magical.progress import ProgressBar

    dataset, replays = Dataset.open(args.dataset), []
    with ProgressBar("replay", len(dataset)) as bar:
        for entry, trajectory in zip(dataset.entries, dataset, strict=True):
            recorded = {"env_id": str(entry.env_id), "recorded": entry.published_code_score}
            result = asdict(summary.replay(trajectory))
            replays.append({"file": entry.file, **recorded, **result})
            bar.advance()
    scores = ("recorded", "published_code_score", "score")
    common.print_records(
        [
            {"env_id": env_id, "count": len(group)}
            | {name: fmean(one[name] for one in group) for name in scores}
            | {"agree": sum(one["agrees"] for one in group)}
            | {"exact": sum(one["departure"] == 0.0 for one in group)}
            for env_id, group in sorted(group_by(replays, lambda one: one["env_id"]).items())
        ]
    )
    agree = sum(one["agrees"] for one in replays)
    print(
        f"{agree} of {len(replays)} replays reproduced the recorded score, by both rules if both "
        "are recorded.\nrecorded, published_code_score: by the published code's rule, recorded and "
        "replayed; score: replayed,\nby the appendix's; exact: replays that ended in the recorded "
        "poses."
    )
    common.print_json(args, {"agree": agree, "replays": replays})
    return 0


def video(args: Args) -> int:
    """Make a video."""
    from magical.demos import Dataset
    from magical.demos.export import write_video

    dataset = Dataset.open(args.dataset)
    first = {entry.env_id: i for i, entry in reversed(list(enumerate(dataset.entries)))}
    chosen = args.index or sorted(first.values())
    if not chosen or not all(0 <= index < len(dataset) for index in chosen):
        found = f"{args.dataset}: found {len(dataset)} demonstrations"
        raise DatasetError(f"{found}, expected numbers from 0 to {len(dataset) - 1} in --index")
    frames = write_video((dataset[i] for i in chosen), args.out)
    print(f"wrote {args.out}: {len(chosen)} demonstrations, {frames} frames")
    common.print_json(args, {"out": str(args.out), "count": len(chosen), "frames": frames})
    return 0


def export(args: Args) -> int:
    """Export to Minari."""
    from magical.demos import Dataset
    from magical.demos.export import export_minari

    if args.out is not None:
        args.out.mkdir(parents=True, exist_ok=True)
        os.environ["MINARI_DATASETS_PATH"] = str(args.out.resolve())
    dataset = Dataset.open(args.dataset)
    made = export_minari(dataset, args.name, args.preset)
    print("\n".join(made))
    common.print_json(args, {"to": args.to, "datasets": made, "episodes": len(dataset)})
    return 0


def push(args: Args) -> int:
    """Upload to the Hub."""
    from magical.demos import Dataset
    from magical.demos.export import push as upload

    dataset = Dataset.open(args.dataset)
    address = upload(dataset, args.repo, args.licence, private=args.private)
    print(f"pushed {len(dataset)} demonstrations to {address}")
    common.print_json(args, {"repository": address, "count": len(dataset)})
    return 0


def pull(args: Args) -> int:
    """Download from the Hub."""
    from magical.demos import export

    dataset = export.pull(args.repo, args.out, args.revision)
    print(f"pulled {len(dataset)} demonstrations into {args.out}")
    common.print_json(args, {"out": str(args.out), "count": len(dataset)})
    return 0


def _log_duplicates(duplicates: Sequence[tuple[str, str]]) -> None:
    for later, earlier in duplicates:
        common.log(f"duplicate: {later!a} shows the same episode as {earlier!a}")
