"""`magical demos import` and `magical demos download`: the published human demonstrations."""

import argparse
import fnmatch
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from magical.commands._common import add_json, log, positive_int, print_json
from magical.commands.demos._shared import (
    Subparsers,
    add_command,
    add_out,
    add_workers,
)
from magical.errors import DownloadError
from magical.messages import printable

if TYPE_CHECKING:
    from magical.demos.human.importing import ImportReport

ARCHIVE = "https://github.com/qxcv/magical-data"


def add_commands(subparsers: Subparsers) -> None:
    """Add both sub-commands."""
    parser = add_command(subparsers, "import", run_import, "read published human demonstrations")
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
    parser = add_command(subparsers, "download", run_download, f"download and import {ARCHIVE}")
    parser.add_argument("--base-url", metavar="URL", help=f"instead of {ARCHIVE}")
    parser.add_argument(
        "--files", default="*", metavar="PATTERN", help="only those, such as 'move-to-corner/*'"
    )
    parser.add_argument(
        "--keep", type=Path, metavar="FOLDER", help="keep the published files there"
    )
    _add_importing(parser)


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
        fetched = fetch_all(missing, folder, args.base_url or BASE_URL, advance)
    for error in fetched.errors:
        log(f"error: {error}")
    # The sums once more: the files could have been replaced after they were fetched.
    sums = {path: missing[name] for name, path in fetched.files.items()}
    errors = fetched.errors
    status = _import(list(sums), args, MAX_UNPACKED, sums=sums, not_fetched=errors)
    if not (args.keep or errors or status):
        shutil.rmtree(folder, ignore_errors=True)
    return 1 if errors else status


def _add_importing(parser: argparse.ArgumentParser) -> None:
    add_out(parser)
    frames = parser.add_mutually_exclusive_group()
    frames.add_argument(
        "--keep-frames", action="store_true", help="keep the 96 x 96 frames beside the poses"
    )
    frames.add_argument(
        "--frames-only", action="store_true", help="do not recover poses, which takes most time"
    )
    parser.add_argument(
        "--skip-duplicates", action="store_true", help="import what is in several files once"
    )
    add_workers(parser)
    add_json(parser)


def _import(
    files: list[Path],
    args: argparse.Namespace,
    max_bytes: int,
    sums: Mapping[Path, str] | None = None,
    not_fetched: Sequence[str] = (),
) -> int:
    from magical.demos.human.importing import Keep, import_published
    from magical.progress import progress_bar

    keep = Keep.FRAMES if args.frames_only else Keep.BOTH if args.keep_frames else Keep.POSES
    with progress_bar("import", len(files)) as advance:
        report = import_published(
            files,
            args.out,
            keep=keep,
            workers=args.workers,
            max_bytes=max_bytes,
            skip_duplicates=args.skip_duplicates,
            sums=sums,
            progress=advance,
        )
    _print_report(report, args.out)
    if args.json:
        print_json({"out": str(args.out), "not_fetched": list(not_fetched), **asdict(report)})
    return 1 if report.failed else 0


def _print_report(report: "ImportReport", out: Path) -> None:
    print(f"imported {len(report.imported)} demonstrations into {out}")
    if report.already:
        print(f"{len(report.already)} were there already")
    for later, earlier in report.duplicates:
        log(f"duplicate: {printable(later)} shows the same as {printable(earlier)}")
    for file, reason in report.without_poses:
        log(f"kept as frames: {printable(file)}: {reason}")
    for _, reason in report.failed:
        log(f"error: {reason}")
