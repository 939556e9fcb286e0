"""`magical demos import` and `magical demos download`: the published human demonstrations."""

import argparse
import fnmatch
import shutil
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from magical.commands._common import log, print_json
from magical.errors import DownloadError
from magical.messages import printable

if TYPE_CHECKING:
    from magical.demos.human.importing import ImportReport

ARCHIVE = "https://github.com/qxcv/magical-data"


def run_import(args: argparse.Namespace) -> int:
    """`magical demos import`."""
    from magical.demos.human.importing import find_published

    return _import(find_published(args.source), args)


def run_download(args: argparse.Namespace) -> int:
    """`magical demos download`: fetch what the dataset lacks, import it, remove the archive."""
    from magical.demos import Dataset, DatasetWriter
    from magical.demos.human.download import BASE_URL, fetch_all
    from magical.demos.human.published import published_sums
    from magical.progress import ProgressBar

    wanted = {f: s for f, s in published_sums().items() if fnmatch.fnmatch(f, args.files)}
    if not wanted:
        raise DownloadError(
            f"--files {args.files}: expected a pattern that published files match, found no match"
        )
    DatasetWriter(args.out)
    have = {(e.source, e.source_sha256) for e in Dataset.open(args.out).entries}
    missing = {f: s for f, s in wanted.items() if (Path(f).name, s) not in have}
    folder = args.keep or args.out / "download"
    with ProgressBar("download", len(missing)) as bar:
        fetched = fetch_all(missing, folder, args.base_url or BASE_URL, bar.advance)
    for error in fetched.errors:
        log(f"error: {error}")
    status = _import(list(fetched.files.values()), args, not_fetched=fetched.errors)
    if not (args.keep or fetched.errors or status):
        shutil.rmtree(folder, ignore_errors=True)
    return 1 if fetched.errors else status


def _import(files: list[Path], args: argparse.Namespace, not_fetched: Sequence[str] = ()) -> int:
    from magical.demos.human.importing import import_published
    from magical.progress import ProgressBar

    with ProgressBar("import", len(files)) as bar:
        report = import_published(
            files,
            args.out,
            keep="frames" if args.frames_only else "both" if args.keep_frames else "poses",
            workers=args.workers,
            skip_duplicates=args.skip_duplicates,
            progress=bar.advance,
        )
    _print_report(report, args)
    print_json(args, {"out": str(args.out), "not_fetched": list(not_fetched), **asdict(report)})
    return 1 if report.failed else 0


def _print_report(report: "ImportReport", args: argparse.Namespace) -> None:
    print(f"imported {len(report.imported)} demonstrations into {args.out}")
    if report.already:
        print(f"{len(report.already)} were already there")
    for later, earlier in report.duplicates:
        log(f"duplicate: {printable(later)} shows the same episode as {printable(earlier)}")
    for file, reason in report.without_poses:
        log(f"kept as frames: {printable(file)}: {reason}")
    for _, reason in report.failed:
        log(f"error: {reason}")
    if args.frames_only and report.imported:
        log(
            "The score (by the appendix's rule) is None where only frames are known; import into "
            "another folder without --frames-only to recover poses and score them."
        )
