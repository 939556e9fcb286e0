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
from typing import Any

from magical.commands import _common as common
from magical.demos import Dataset, DatasetWriter, export, generate, human
from magical.demos.dataset import summarise
from magical.demos.trajectory import replay
from magical.envs import parse_env_id
from magical.errors import DatasetError
from magical.grouping import group_by
from magical.processes import checked_workers
from magical.progress import ProgressBar

ARCHIVE = "https://github.com/qxcv/magical-data"
DATASET = "dataset to create or append to"
POSITIONAL: dict[str, tuple[type, str, str]] = {
    "source": (Path, "SRC", "a folder with *.pkl.gz files, or one such file"),
    "dataset": (Path, "DIR", "the dataset's folder"),
    "repo": (str, "OWNER/NAME", "the dataset repository"),
}

Args = argparse.Namespace
Result = dict[str, Any]  # the object of --json


def configure(parser: argparse.ArgumentParser) -> None:
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)

    def add(
        function: Callable[[Args], Result], meaning: str, *positionals: str
    ) -> argparse.ArgumentParser:
        command = commands.add_parser(function.__name__.strip("_"), help=meaning)
        command.set_defaults(function=function)
        for name in positionals:
            kind, metavar, described = POSITIONAL[name]
            command.add_argument(name, type=kind, metavar=metavar, help=described)
        common.add_json(command)
        return command

    importing = add(_import, "import published human demonstrations", "source")
    command = add(_download, f"download and import {ARCHIVE}")
    command.add_argument("--base-url", metavar="URL", help=f"use it instead of {ARCHIVE}")
    meaning = "download only the files that match, such as 'move-to-corner/*'"
    command.add_argument("--files", default="*", metavar="PATTERN", help=meaning)
    meaning = "keep the downloaded files in this folder"
    command.add_argument("--keep", type=Path, metavar="FOLDER", help=meaning)
    for each in (importing, command):
        common.add_out(each, DATASET, required=True)
        meaning = "import demonstrations that are in several files only once"
        each.add_argument("--skip-duplicates", action="store_true", help=meaning)
        common.add_workers(each)
    command = add(_generate, "roll out the scripted experts")
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
    add(_info, "show what a dataset contains", "dataset")
    add(_replay, "resimulate the recorded actions and score the result", "dataset")
    command = add(_video, "make a video, with both views side by side", "dataset")
    common.add_out(command, "video to write, FILE.mp4", "FILE", required=True)
    meaning = "numbers of the demonstrations, from 0 (default: the first of each environment)"
    common.add_several(command, "--index", meaning, "I", kind=int)
    command = add(_export, "export a dataset to Minari", "dataset")
    command.add_argument("--to", choices=("minari",), required=True, help="target format")
    common.add_out(command, "the folder of Minari's datasets (default: Minari's own)", "FOLDER")
    command.add_argument("--name", default="demos", help="last part of the id (default: demos)")
    meaning = "observation preset (default: LoRes4E)"
    command.add_argument("--preset", default="LoRes4E", help=meaning)
    command = add(_push, "upload a dataset to the Hugging Face Hub", "dataset", "repo")
    meaning = "licence identifier of the Hub, such as cc-by-4.0"
    command.add_argument("--licence", "--license", required=True, metavar="ID", help=meaning)
    command.add_argument("--private", action="store_true", help="make a new repository private")
    command = add(_pull, "download a dataset from the Hugging Face Hub", "repo")
    common.add_out(command, "new folder to download into", required=True)
    command.add_argument("--revision", metavar="REV", help="a branch, tag or commit")


def run(args: Args) -> int:
    if "dataset" in args:
        args.dataset = Dataset.open(args.dataset)
    if "workers" in args:
        args.workers = checked_workers(args.workers)
    result = args.function(args)
    common.print_json(args, result)
    return int(bool(result.get("failed") or result.get("not_fetched")))


def _import(args: Args) -> Result:
    return _import_files(human.find_published(args.source), args)


def _download(args: Args) -> Result:
    """Fetch what the dataset lacks, import it, remove the files."""
    sums = human.published_sums().items()
    wanted = {file: digest for file, digest in sums if fnmatch.fnmatch(file, args.files)}
    if not wanted:
        raise DatasetError(f"--files {args.files}: expected a pattern that published files match")
    DatasetWriter(args.out)
    have = {entry.name for entry in Dataset.open(args.out).entries}
    lacking = {file: digest for file, digest in wanted.items() if Path(file).name not in have}
    folder, url = args.keep or args.out / "download", args.base_url or human.BASE_URL
    with ProgressBar("download", len(lacking)) as bar:
        files, errors = human.download(lacking, folder, url, bar.advance)
    for error in errors:
        common.log(f"error: {error}")
    result = _import_files(files, args) | {"not_fetched": errors}
    if not (args.keep or errors or result["failed"]):
        shutil.rmtree(folder, ignore_errors=True)
    return result


def _import_files(files: list[Path], args: Args) -> Result:
    options = {"workers": args.workers, "skip_duplicates": args.skip_duplicates}
    with ProgressBar("import", len(files)) as bar:
        report = human.import_published(files, args.out, progress=bar.advance, **options)
    print(f"imported {len(report.imported)} demonstrations into {args.out}")
    if report.already:
        print(f"{len(report.already)} were already there")
    _log_duplicates(report.duplicates)
    for _, reason in report.failed:
        common.log(f"error: {reason}")
    return {"out": str(args.out), "not_fetched": [], **asdict(report)}


def _log_duplicates(duplicates: Sequence[tuple[str, str]]) -> None:
    for later, earlier in duplicates:
        common.log(f"duplicate: {later!a} shows the same episode as {earlier!a}")


def _generate(args: Args) -> Result:
    ids = [parse_env_id(env_id).without_preset for env_id in args.env]
    names = ("seed", "first", "perturb", "min_score", "workers")
    options = {name: getattr(args, name) for name in names}
    with ProgressBar("generate", args.n * len(ids)) as bar:
        options["progress"] = bar.advance
        made = [generate.generate(env_id, args.n, args.out, **options) for env_id in ids]
    reports = [asdict(report) for report in made]
    common.print_records([{**report, "scores": fmean(report["scores"])} for report in reports])
    if copies := Dataset.open(args.out).duplicates():
        common.log(
            f"warning: {args.out}: demonstrations that duplicate earlier ones: {len(copies)}; in "
            "the same scene, an expert repeats itself unless its actions are perturbed (--perturb)"
        )
    return {"out": str(args.out), "environments": reports}


def _info(args: Args) -> Result:
    summaries, duplicates = summarise(args.dataset.entries), args.dataset.duplicates()
    common.print_records(summaries)
    _log_duplicates(duplicates)
    return {"count": len(args.dataset), "environments": summaries, "duplicates": duplicates}


def _replay(args: Args) -> Result:
    replays = []
    with ProgressBar("replay", len(args.dataset)) as bar:
        for entry, trajectory in zip(args.dataset.entries, args.dataset, strict=True):
            recorded = {"env_id": str(entry.env_id), "recorded": entry.published_code_score}
            replays.append({"file": entry.file, **recorded, **asdict(replay(trajectory))})
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
    return {"agree": agree, "replays": replays}


def _video(args: Args) -> Result:
    entries = args.dataset.entries
    first = {entry.env_id: i for i, entry in reversed(list(enumerate(entries)))}
    chosen = args.index or sorted(first.values())
    if not chosen or not all(0 <= index < len(entries) for index in chosen):
        raise DatasetError(f"--index: expected numbers of {len(entries)} demonstrations, from 0")
    frames = export.write_video((args.dataset[i] for i in chosen), args.out)
    print(f"wrote {args.out}: {len(chosen)} demonstrations, {frames} frames")
    return {"out": str(args.out), "count": len(chosen), "frames": frames}


def _export(args: Args) -> Result:
    if args.out is not None:
        args.out.mkdir(parents=True, exist_ok=True)
        os.environ["MINARI_DATASETS_PATH"] = str(args.out.resolve())
    made = export.export_minari(args.dataset, args.name, args.preset)
    print("\n".join(made))
    return {"to": args.to, "datasets": made, "episodes": len(args.dataset)}


def _push(args: Args) -> Result:
    address = export.push(args.dataset, args.repo, args.licence, private=args.private)
    print(f"pushed {len(args.dataset)} demonstrations to {address}")
    return {"repository": address, "count": len(args.dataset)}


def _pull(args: Args) -> Result:
    dataset = export.pull(args.repo, args.out, args.revision)
    print(f"pulled {len(dataset)} demonstrations into {args.out}")
    return {"out": str(args.out), "count": len(dataset)}
