"""The metrics of a run: the only writer and the only reader of `metrics.jsonl`."""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from magical.errors import RunFolderError
from magical.files import write_atomically
from magical.messages import quoted
from magical.runs.folder import METRICS
from magical.untrusted import read_json_lines


class MetricsWriter:
    """Appends metrics to a run folder, one line of JSON per call."""

    def __init__(self, folder: Path, step: int) -> None:
        """`step` is the checkpoint's: later metrics are dropped, as their steps are redone."""
        path = folder / METRICS
        if path.exists():
            kept = [row for row in read_metrics(folder) if row["step"] <= step]
            with write_atomically(path) as file:
                file.write("".join(json.dumps(row) + "\n" for row in kept).encode())
        self._file = path.open("a", encoding="utf-8")

    def write(self, step: int, metrics: Mapping[str, float | str]) -> None:
        """Append a line; numbers are rounded to 6 decimals, and non-finite ones become null."""
        row = {"step": step, **{name: _plain(value) for name, value in metrics.items()}}
        self._file.write(json.dumps(row) + "\n")
        self._file.flush()

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def read_metrics(run: Path | str) -> list[dict[str, Any]]:
    """The metrics of a run folder, oldest first; empty if there are none yet.

    A last line that a crash has truncated is left out.

    Raises:
        RunFolderError: any other line is not a JSON object with a step.
    """
    path = Path(run) / METRICS
    if not path.exists():
        return []
    rows = list(read_json_lines(path, dict[str, Any], RunFolderError))
    for number, row in enumerate(rows, 1):
        if not isinstance(row.get("step"), int):
            raise RunFolderError(f"{path}: line {number}: expected a step, found {quoted(row)}")
    return rows


def _plain(value: float | str) -> float | int | str | None:
    if isinstance(value, int | str):
        return value
    return round(float(value), 6) if math.isfinite(value) else None
