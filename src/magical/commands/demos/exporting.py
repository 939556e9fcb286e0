"""`magical demos video` and `magical demos export`: demonstrations in other formats."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from magical.commands._common import add_json, non_negative_int, print_json
from magical.commands.demos._shared import Subparsers, add_command, add_dataset, log_problems
from magical.errors import DatasetError

if TYPE_CHECKING:
    from magical.demos import Dataset


def add_commands(subparsers: Subparsers) -> None:
    """Add both sub-commands."""
    _add_video(add_command(subparsers, "video", run_video, "a video, both views side by side"))
    _add_export(add_command(subparsers, "export", run_export, "to Minari or LeRobot"))


def _add_video(parser: argparse.ArgumentParser) -> None:
    add_dataset(parser)
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
        "--rate", type=float, default=8.0, metavar="HZ", help="steps per second (default: 8)"
    )


def _add_export(parser: argparse.ArgumentParser) -> None:
    add_dataset(parser)
    parser.add_argument("--to", choices=("minari", "lerobot"), required=True)
    parser.add_argument(
        "--out",
        type=Path,
        metavar="FOLDER",
        help="lerobot: a new folder; minari: its folder of datasets (default: Minari's own)",
    )
    parser.add_argument("--name", default="demos", help="minari: the last part of the id")
    parser.add_argument(
        "--preset", default="LoRes4E", help="minari: the observations (default: LoRes4E)"
    )
    parser.add_argument(
        "--skip-damaged", action="store_true", help="leave damaged trajectories out"
    )
    add_json(parser)


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
    log_problems(dataset.problems)
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


def _first_of_each(dataset: "Dataset") -> list[int]:
    first: dict[str, int] = {}
    for i, entry in enumerate(dataset.entries):
        first.setdefault(entry.env_id, i)
    return list(first.values())
