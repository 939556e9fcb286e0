"""Many evaluated runs in two files: `entries.json` and `scores.csv.gz` (docs/protocol.md).

`entries.json` holds each run's `entry.json` by name, `scores.csv.gz` the rows of all `scores.csv`,
each preceded by the name. A hundred runs take a hundredth of the space of their folders.
"""

import csv
import gzip
import io
import json
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from magical.errors import ScoresError
from magical.evaluation.entry import Entry, make_entry
from magical.evaluation.scores import HEADER, RolloutScore, parse_row, read_lines
from magical.files import open_regular, write_atomically
from magical.untrusted import read_json

ENTRIES_FILE, ROWS_FILE = "entries.json", "scores.csv.gz"
MAX_BYTES = 1 << 26  # of `entries.json`
MAX_ROWS = 1_000_000  # of a compressed file, which may hold any number: 166 runs on sixty variants


def is_collection(folder: Path) -> bool:
    """Whether a folder holds a collection."""
    return (folder / ENTRIES_FILE).exists()


def write_collection(folder: Path, entries: Mapping[str, Entry]) -> None:
    """Write the entries by name; the same entries give the same bytes."""
    with (
        write_atomically(folder / ROWS_FILE) as file,
        gzip.GzipFile("", "wb", fileobj=file, mtime=0) as packed,
        io.TextIOWrapper(packed, "utf-8", newline="") as text,
    ):
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(("entry", *HEADER))
        for name, entry in sorted(entries.items()):
            writer.writerows((name, *row) for row in entry.scores)
    stated = {name: entry.stated for name, entry in sorted(entries.items())}
    with write_atomically(folder / ENTRIES_FILE) as file:
        file.write((json.dumps(stated, indent=1) + "\n").encode())


def read_collection(folder: Path) -> dict[str, Entry | ScoresError]:
    """Read every entry by name; for a damaged one the value is its error.

    Raises:
        ScoresError: a file is missing or damaged; the message says which and what was expected.
    """
    stated = read_json(
        folder / ENTRIES_FILE, dict[str, dict[str, Any]], ScoresError, max_bytes=MAX_BYTES
    )
    scores = _read_scores(folder / ROWS_FILE)
    return {name: _entry(folder, name, data, scores.get(name, [])) for name, data in stated.items()}


def _entry(
    folder: Path, name: str, data: dict[str, Any], scores: list[RolloutScore]
) -> Entry | ScoresError:
    try:
        places = (f"{folder / file}: {name}" for file in (ENTRIES_FILE, ROWS_FILE))
        return make_entry(data, scores, *places)
    except ScoresError as error:
        return error


def _read_scores(path: Path) -> dict[str, list[RolloutScore]]:
    """The rows of each entry, by its name."""
    scores: dict[str, list[RolloutScore]] = {}
    try:
        with (
            open_regular(path, follow_links=True) as file,
            gzip.GzipFile(fileobj=file, mode="rb") as rows,
        ):
            lines = read_lines(rows, ("entry", *HEADER), path, MAX_ROWS)
            for number, line in enumerate(lines, 2):
                row = parse_row(line[1:], path, number)
                scores.setdefault(line[0], []).append(row)
    except (OSError, EOFError, zlib.error) as error:
        raise ScoresError(f"{path}: expected compressed scores: {error}") from error
    return scores
