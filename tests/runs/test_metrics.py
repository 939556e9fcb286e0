"""The writer and the reader of metrics."""

import math
import re
from pathlib import Path

import pytest

from magical.errors import RunFolderError
from magical.runs.folder import METRICS
from magical.runs.metrics import MetricsWriter, read_metrics


def write(folder: Path, step: int, *rows: tuple[int, float]) -> None:
    writer = MetricsWriter(folder, step)
    for number, loss in rows:
        writer.write(number, {"loss": loss})
    writer.close()


def append(folder: Path, text: str) -> None:
    with (folder / METRICS).open("a") as file:
        file.write(text)


def test_what_is_written_is_read(tmp_path: Path) -> None:
    assert read_metrics(tmp_path) == []
    writer = MetricsWriter(tmp_path, 0)
    writer.write(1, {"loss": 0.12345678, "episodes": 3, "warning": "one action"})
    writer.write(2, {"loss": math.nan, "least": -math.inf})
    assert read_metrics(tmp_path) == [  # at once, before the file is closed
        {"step": 1, "loss": 0.123457, "episodes": 3, "warning": "one action"},
        {"step": 2, "loss": None, "least": None},
    ]
    writer.close()


def test_metrics_after_the_checkpoint_are_dropped(tmp_path: Path) -> None:
    write(tmp_path, 0, (1, 0.5), (2, 0.25), (3, 0.125))
    append(tmp_path, '{"step": 4, "lo')
    assert [row["step"] for row in read_metrics(tmp_path)] == [1, 2, 3]
    write(tmp_path, 2, (3, 0.75))
    assert [row["loss"] for row in read_metrics(tmp_path)] == [0.5, 0.25, 0.75]


@pytest.mark.parametrize(
    ("line", "found"),
    [
        (b"{half", "expected JSON, found something else"),
        (b"[]", "expected object, found array"),
        (b'{"loss": 1}', "expected a step, found {'loss': 1}"),
        (b'{"step": "1"}', "expected a step, found {'step': '1'}"),
        (b'{"step": 1, "loss": "\xff"}', "expected JSON, found something else"),
    ],
)
def test_a_damaged_line_is_named(tmp_path: Path, line: bytes, found: str) -> None:
    write(tmp_path, 0, (1, 0.5))
    with (tmp_path / METRICS).open("ab") as file:
        file.write(line + b"\n")
    with pytest.raises(RunFolderError, match=re.escape(f"line 2: {found}")):
        read_metrics(tmp_path)
