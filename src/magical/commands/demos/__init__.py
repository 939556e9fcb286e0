"""Demonstrations: import the human ones, generate, inspect, replay, render and export.

A dataset DIR is a folder with one file for each demonstration, and a manifest.
"""

import argparse
from pathlib import Path

from magical.commands._common import (
    add_count,
    add_json,
    add_number,
    add_out,
    add_seed,
    add_several,
    add_workers,
    number,
)
from magical.commands.demos import datasets, human

HELP = "demonstrations: import, generate, replay, export, push"
DATASET = "dataset to create or append to"


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the sub-commands and their arguments."""
    add = parser.add_subparsers(title="commands", metavar="COMMAND", required=True).add_parser
    replay = "resimulate the recorded actions and score the result"
    for name, run_demos, describe, meaning in (
        ("import", human.run_import, _import, "import published human demonstrations"),
        ("download", human.run_download, _download, f"download and import {human.ARCHIVE}"),
        ("generate", datasets.run_generate, _generate, "roll out the scripted experts"),
        ("info", datasets.run_info, _info, "show what a dataset contains, and its problems"),
        ("replay", datasets.run_replay, _dataset, replay),
        ("video", datasets.run_video, _video, "make a video, with both views side by side"),
        ("export", datasets.run_export, _export, "export a dataset to Minari or LeRobot"),
        ("push", datasets.run_push, _push, "upload a dataset to the Hugging Face Hub"),
        ("pull", datasets.run_pull, _pull, "download a dataset from the Hugging Face Hub"),
    ):
        command = add(name, help=meaning)
        command.set_defaults(run_demos=run_demos)
        describe(command)
        add_json(command)


def run(args: argparse.Namespace) -> int:
    """Run the chosen sub-command."""
    return int(args.run_demos(args))


def _import(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "source", type=Path, metavar="SRC", help="a folder with *.pkl.gz files, or one such file"
    )
    _importing(parser)


def _download(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--base-url", metavar="URL", help=f"use it instead of {human.ARCHIVE}")
    parser.add_argument(
        "--files",
        default="*",
        metavar="PATTERN",
        help="download only the files that match, such as 'move-to-corner/*'",
    )
    parser.add_argument(
        "--keep", type=Path, metavar="FOLDER", help="keep the downloaded files in this folder"
    )
    _importing(parser)


def _importing(parser: argparse.ArgumentParser) -> None:
    add_out(parser, DATASET, required=True)
    frames = parser.add_mutually_exclusive_group()
    frames.add_argument(
        "--keep-frames", action="store_true", help="keep the 96 x 96 frames with the poses"
    )
    frames.add_argument(
        "--frames-only", action="store_true", help="do not recover poses, the slowest step"
    )
    parser.add_argument(
        "--skip-duplicates",
        action="store_true",
        help="import demonstrations that are in several files only once",
    )
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
    _action_space(parser, "type of the stored actions (default: discrete)", default="discrete")
    add_workers(parser)


def _info(parser: argparse.ArgumentParser) -> None:
    _dataset(parser)
    parser.add_argument(
        "--repair", action="store_true", help="rebuild the manifest from the intact trajectories"
    )


def _video(parser: argparse.ArgumentParser) -> None:
    _dataset(parser)
    add_out(parser, "video to write, FILE.mp4 or FILE.webp", "FILE", required=True)
    meaning = "numbers of the demonstrations, from 0 (default: the first of each environment)"
    add_several(parser, "--index", meaning, "I", kind=number(int, 0))


def _export(parser: argparse.ArgumentParser) -> None:
    _dataset(parser)
    parser.add_argument("--to", choices=("minari", "lerobot"), required=True, help="target format")
    meaning = "lerobot: a new folder; minari: the folder of datasets (default: Minari's own)"
    add_out(parser, meaning, "FOLDER")
    parser.add_argument("--name", help="minari: last part of the dataset id (default: demos)")
    parser.add_argument("--preset", help="minari: observation preset (default: LoRes4E)")
    _action_space(parser, "type of the exported actions (default: the dataset's)")
    parser.add_argument(
        "--skip-damaged", action="store_true", help="leave damaged trajectories out"
    )


def _push(parser: argparse.ArgumentParser) -> None:
    _dataset(parser)
    _repository(parser)
    parser.add_argument(
        "--licence",
        "--license",
        required=True,
        metavar="ID",
        help="licence identifier of the Hub, such as cc-by-4.0",
    )
    parser.add_argument("--private", action="store_true", help="make a new repository private")


def _pull(parser: argparse.ArgumentParser) -> None:
    _repository(parser)
    add_out(parser, "new folder to download into", "DIR", required=True)
    parser.add_argument("--revision", metavar="REV", help="a branch, tag or commit")


def _repository(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("repo", metavar="OWNER/NAME", help="the dataset repository")


def _action_space(
    parser: argparse.ArgumentParser, meaning: str, default: str | None = None
) -> None:
    parser.add_argument(
        "--action-space", choices=("discrete", "continuous"), default=default, help=meaning
    )


def _dataset(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("dataset", type=Path, metavar="DIR", help="the dataset's folder")
