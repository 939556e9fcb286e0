"""Validate entries submitted to the leaderboard; each is a folder with a `submission.json`.

    python -m tools.entries [--entries FOLDER] [NAME ...]
    python -m tools.entries NAME --describe runs/0=policy.py:POLICY [...]

An entry is refused, with the reason, if a file is missing, undescribed or does not have the stated
SHA-256 sum, if the entry does not follow the protocol, or if a sample of its rollouts, run again,
contradicts its scores. This runs the entry's code: do it only where that can do no harm. With
--describe, the entry's `submission.json` is written instead.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from magical.errors import MagicalError
from magical.evaluation.entry import ENTRY_FILE
from magical.files import LOCK, read_json, sha256_sum, write_json
from magical.report.found import Found, search_results
from magical.report.leaderboard import check_entries

ROOT = Path(__file__).resolve().parents[1]
SUBMISSION = "submission.json"
README = "README.md"  # may be in an entry's folder without being described


class SubmissionError(MagicalError, ValueError):
    """A submission that cannot be accepted."""


@dataclass(frozen=True)
class Submission:
    """The contents of `submission.json`.

    Args:
        policies: the policy of each run, by the run's path in the entry's folder: `file.py:NAME`
            with a file in the entry's folder, or empty for the run's own policy.
        files: the SHA-256 sum of every other file, by its path in the entry's folder.
    """

    policies: Mapping[str, str]
    files: Mapping[str, str]


def reasons(folder: Path, others: Sequence[Path] = ()) -> list[str]:
    """Why an entry is refused; empty if it is accepted.

    Args:
        folder: the entry's folder.
        others: the folders of the other entries.
    """
    try:
        submission = read_json(folder / SUBMISSION, Submission, SubmissionError)
        return (
            list(_file_faults(folder, submission))
            or list(_protocol_faults(folder, submission, others))
            or list(_contradictions(folder, submission))
        )
    except (MagicalError, OSError) as error:
        return [str(error)]


def _file_faults(folder: Path, submission: Submission) -> Iterator[str]:
    for name, stated in submission.files.items():
        path = folder / name
        if PurePosixPath(name).is_absolute() or ".." in PurePosixPath(name).parts:
            yield f"{name}: expected a path in the entry's folder"
        elif not path.is_file() or path.is_symlink():
            yield f"{name}: expected a file, found none"
        elif (found := sha256_sum(path)) != stated:
            yield f"{name}: expected the SHA-256 sum {stated}, found {found}"
    for name in sorted(set(_files(folder)) - set(submission.files)):
        yield f"{name}: expected in {SUBMISSION}, or not at all"
    for run, policy in submission.policies.items():
        if f"{run}/{ENTRY_FILE}" not in submission.files:
            yield f"{run}: expected an entry, found none"
        if policy and policy.rpartition(":")[0] not in submission.files:
            yield f"{run}: expected the policy in a file of {SUBMISSION}, found {policy}"


def _files(folder: Path) -> Iterator[str]:
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        left_over = path.name == LOCK or "__pycache__" in path.parts
        if path.is_file() and name not in (SUBMISSION, README) and not left_over:
            yield name


def _protocol_faults(folder: Path, submission: Submission, others: Sequence[Path]) -> Iterator[str]:
    found = search_results([folder, *others])
    ours = {result.folder for result in found.results if folder in result.folder.parents}
    for run in sorted(ours - {folder / run for run in submission.policies}):
        yield f"{run.relative_to(folder)}: expected its policy in {SUBMISSION}"
    _, rejected = check_entries(_ours_last(found, folder))
    for entry in rejected:
        if folder in (Path(entry.folder), *Path(entry.folder).parents):
            yield f"{Path(entry.folder).relative_to(folder)}: {'; '.join(entry.reasons)}"


def _ours_last(found: Found, folder: Path) -> Found:
    """The same entries, with those in `folder` last: if two conflict, the latter is refused."""
    ordered = sorted(found.results, key=lambda result: folder in result.folder.parents)
    return Found(ordered, found.skipped)


def _contradictions(folder: Path, submission: Submission) -> Iterator[str]:
    for run, policy in submission.policies.items():
        named = ["--policy", f"{folder / policy}"] if policy else []
        command = [sys.executable, "-m", "magical", "verify", str(folder / run), *named, "--json"]
        with tempfile.TemporaryDirectory() as cache:  # so that no submitted bytecode is run
            done = subprocess.run(
                command,
                env={**os.environ, "PYTHONPYCACHEPREFIX": cache},
                capture_output=True,
                text=True,
                check=False,
            )
        *report, result = done.stdout.splitlines() or [""]
        if not _is_confirmed(result):
            lines = done.stderr.splitlines() or report or ["magical verify ended without a result"]
            yield f"{run}: {lines[-1]}"


def _is_confirmed(result: str) -> bool:
    """Whether the JSON object of `magical verify` says so; its exit status is the entry's."""
    with suppress(ValueError):
        found = json.loads(result)
        return isinstance(found, dict) and found.get("confirmed") is True
    return False


def describe(folder: Path, policies: Mapping[str, str]) -> None:
    """Write an entry's `submission.json`."""
    files = {name: sha256_sum(folder / name) for name in _files(folder)}
    write_json(folder / SUBMISSION, {"policies": dict(policies), "files": files})


def main(argv: Sequence[str] | None = None) -> int:
    """Validate or describe entries; returns 1 if one is refused."""
    parser = argparse.ArgumentParser(prog="python -m tools.entries", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help="of an entry (default: all)")
    parser.add_argument("--entries", type=Path, default=ROOT / "entries", metavar="FOLDER")
    parser.add_argument("--describe", nargs="+", metavar="RUN=POLICY", help="write its submission")
    arguments = parser.parse_args(argv)
    everything = sorted(path for path in arguments.entries.iterdir() if path.is_dir())
    chosen = [arguments.entries / name for name in arguments.names] or everything
    if arguments.describe:
        pairs = [pair.partition("=") for pair in arguments.describe]
        if (
            len(arguments.names) != 1
            or not chosen[0].is_dir()
            or not all(sep for _, sep, _ in pairs)
        ):
            parser.error("expected one NAME of a folder, then --describe RUN=POLICY ...")
        describe(chosen[0], {run: policy for run, _, policy in pairs})
        return 0
    refused = False
    for folder in chosen:
        found = reasons(folder, [other for other in everything if other != folder])
        refused |= bool(found)
        for reason in found or ["accepted"]:
            print(f"{folder.name}: {reason}")
    return int(refused)


if __name__ == "__main__":
    sys.exit(main())
