"""Demonstrations: import the human ones, generate, inspect, replay, film and export.

A dataset DIR is a folder with one file a demonstration and a manifest.
"""

import argparse
import importlib
from pathlib import Path

from magical.commands._common import add_json, non_negative_int, positive_int

HELP = "demonstrations: import, generate, replay, export"
ARCHIVE = "https://github.com/qxcv/magical-data"


def configure(parser: argparse.ArgumentParser) -> None:
    """Describe the commands and their arguments."""
    subs = parser.add_subparsers(title="commands", metavar="COMMAND", dest="what", required=True)
    _configure_import(subs.add_parser("import", help="read published human demonstrations"))
    _configure_download(subs.add_parser("download", help=f"get and import {ARCHIVE}"))
    _configure_generate(subs.add_parser("generate", help="let the scripted experts demonstrate"))
    _configure_info(subs.add_parser("info", help="what a dataset holds, and what is wrong with it"))
    _configure_replay(subs.add_parser("replay", help="run the actions again in today's physics"))
    _configure_video(subs.add_parser("video", help="a film, both views side by side"))
    _configure_export(subs.add_parser("export", help="to Minari or LeRobot"))


def run(args: argparse.Namespace) -> int:
    """Do what the sub-command says."""
    module = importlib.import_module("magical.commands._demos")
    return int(getattr(module, f"run_{args.what}")(args))


def _configure_import(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "source", type=Path, metavar="SRC", help="a folder with *.pkl.gz files, or one such file"
    )
    parser.add_argument(
        "--max-unpacked",
        type=positive_int,
        default=512,
        metavar="MB",
        help="the most that one file may unpack to (default: 512)",
    )
    _add_importing(parser)


def _configure_download(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--base-url", metavar="URL", help=f"instead of {ARCHIVE}")
    parser.add_argument(
        "--files", default="*", metavar="PATTERN", help="only those, such as 'move-to-corner/*'"
    )
    parser.add_argument(
        "--keep", type=Path, metavar="FOLDER", help="keep the published files there"
    )
    _add_importing(parser)


def _add_importing(parser: argparse.ArgumentParser) -> None:
    _add_out(parser)
    parser.add_argument(
        "--skip-duplicates", action="store_true", help="import what is in several files once"
    )
    _add_workers(parser)
    add_json(parser)


def _configure_generate(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--env", action="append", required=True, metavar="ID", help="environment; may be repeated"
    )
    parser.add_argument(
        "-n",
        type=positive_int,
        default=25,
        metavar="N",
        help="demonstrations of each (default: 25)",
    )
    _add_out(parser)
    parser.add_argument("--seed", type=non_negative_int, default=0, metavar="S", help="default: 0")
    parser.add_argument(
        "--min-score", type=float, default=0.0, metavar="X", help="drop those that score less"
    )
    parser.add_argument(
        "--skill", type=float, default=1.0, metavar="K", help="below 1: worse on purpose"
    )
    _add_workers(parser)
    add_json(parser)


def _configure_info(parser: argparse.ArgumentParser) -> None:
    _add_dataset(parser)
    parser.add_argument(
        "--repair", action="store_true", help="list the intact trajectories in a new manifest"
    )
    add_json(parser)


def _configure_replay(parser: argparse.ArgumentParser) -> None:
    _add_dataset(parser)
    add_json(parser)


def _configure_video(parser: argparse.ArgumentParser) -> None:
    _add_dataset(parser)
    parser.add_argument(
        "--out", type=Path, required=True, metavar="FILE", help="FILE.mp4 or FILE.webp"
    )
    parser.add_argument(
        "--index",
        type=non_negative_int,
        action="append",
        metavar="I",
        help="which demonstration, from 0; may be repeated (default: one of each environment)",
    )
    parser.add_argument(
        "--rate", type=float, default=8.0, metavar="HZ", help="steps a second (default: 8)"
    )


def _configure_export(parser: argparse.ArgumentParser) -> None:
    _add_dataset(parser)
    parser.add_argument("--to", choices=("minari", "lerobot"), required=True)
    parser.add_argument(
        "--out",
        type=Path,
        metavar="FOLDER",
        help="lerobot: a new folder; minari: its folder of datasets (default: Minari's own)",
    )
    parser.add_argument("--name", default="demos", help="minari: the last part of the id")
    parser.add_argument(
        "--preset", default="LoRes4E", help="minari: what is observed (default: LoRes4E)"
    )
    parser.add_argument(
        "--skip-damaged", action="store_true", help="leave damaged trajectories out"
    )
    add_json(parser)


def _add_dataset(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("dataset", type=Path, metavar="DIR", help="the dataset's folder")


def _add_out(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--out", type=Path, required=True, metavar="DIR", help="dataset to append to, or to make"
    )


def _add_workers(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--workers", type=positive_int, metavar="K", help="processes (default: one a core)"
    )
