"""Files of others become records or one error; files are written whole or not at all."""

import errno
import json
import os
import re
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import pytest

from magical.errors import PlanError
from magical.files import (
    MAX_BYTES,
    convert,
    parse_json,
    read_json,
    read_toml,
    write_atomically,
)


class Letter(StrEnum):
    A = "a"
    B = "b"


@dataclass(frozen=True)
class Row:
    name: Annotated[str, msgspec.Meta(max_length=5)]
    count: Annotated[int, msgspec.Meta(ge=0, le=9)] = 0
    weight: float = 0.0
    letter: Letter = Letter.A

    def __post_init__(self) -> None:
        if self.count == 7:
            raise ValueError("count: expected another number than 7")


@dataclass(frozen=True)
class Table:
    rows: list[Row]
    by_name: dict[str, Literal[1, 2]] = field(default_factory=dict)
    details: dict[str, Any] = field(default_factory=dict)


def table(text: str | bytes) -> Table:
    return parse_json(text, Table, "file", PlanError)


def test_data_become_records() -> None:
    read = table('{"rows": [{"name": "x", "weight": 1, "letter": "b"}], "details": {"a": [1]}}')
    assert read == Table([Row("x", 0, 1.0, Letter.B)], details={"a": [1]})
    assert isinstance(read.rows[0].weight, float)
    assert parse_json("[1, {}]", list[Any], "file", PlanError) == [1, {}]
    assert parse_json('{"1": 2}', dict[int, int], "file", PlanError) == {1: 2}


MISFITS = {
    '{"rows": [{"name": "x"}, {"name": 5}]}': "file: rows[1].name: expected str, found int",
    '{"rows": [{}]}': "file: rows[0]: expected the field name",
    "[]": "file: expected object, found array",
    '{"rows": [{"name": "x", "count": 10}]}': "file: rows[0].count: expected int <= 9",
    '{"rows": [{"name": "x", "count": true}]}': "file: rows[0].count: expected int, found bool",
    '{"rows": [{"name": "x", "count": 7}]}': "file: rows[0]: count: expected another number than 7",
    '{"rows": [{"name": "\\u001b\\n*****"}]}': "file: rows[0].name: expected str of length <= 5",
    '{"rows": [{"name": "x", "letter": "z"}]}': "file: rows[0].letter: Invalid enum value 'z'",
    '{"rows": [], "by_name": {"a": 3}}': "file: by_name[...]: Invalid enum value 3",
    '{"rows": [{"name": "x"}, {"name": "y", "cuont": 1}]}': (
        "file: rows[1]: expected the fields name, count, weight, letter, found 'cuont'"
    ),
    '{"rows": [], "row": 1}': "file: expected the fields rows, by_name, details, found 'row'",
    '{"rows": [], "details": {"a": ' + "1" * 400 + "}}": (
        "file: expected finite numbers, found <integer of 1326 bits>"
    ),
    '{"rows": [], "details": ' + '{"a":' * 40 + "1" + "}" * 41: (
        "file: expected data nested at most 32 levels deep, found more"
    ),
}


@pytest.mark.parametrize(("text", "problem"), MISFITS.items())
def test_misfits_are_named_with_their_place(text: str, problem: str) -> None:
    with pytest.raises(PlanError) as refused:
        table(text)
    assert str(refused.value) == problem


BAD_JSON = (
    b'{"rows": [], "details": {"a": NaN}}',
    b'{"rows": [], "details": {"a": 1e400}}',
    b'{"rows": [], "details": {"a": ' + b"1" * 100_000 + b"}}",
    b"[" * 100_000,
    b'"' + b"\x1b" * MAX_BYTES,
    json.dumps({"rows": [], "\x1b" * 50_000: 1}).encode(),
    json.dumps({"rows": [{"name": " - at `$.x" * 50_000}]}).encode(),
)
BAD_TOML = (
    b"a = nan",
    b"a = " + b"1" * 400,
    b"a = " + b"[" * 990,
    b"[" + b"a." * 400 + b"a]",
    b"a." * 30_000 + b"a = 1",
    b"# ...\n" * 20_000,
)


@pytest.mark.parametrize("data", BAD_JSON, ids=range(len(BAD_JSON)))
def test_bad_json_is_one_bounded_printable_error(data: bytes) -> None:
    with pytest.raises(PlanError, match=r"^file: ") as error:
        table(data)
    assert len(str(error.value)) < 900
    assert str(error.value).isprintable()


@pytest.mark.parametrize("data", BAD_TOML, ids=range(len(BAD_TOML)))
def test_bad_toml_is_one_bounded_printable_error(data: bytes, tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(data)
    with pytest.raises(PlanError, match=f"^{re.escape(str(path))}: expected ") as error:
        read_toml(path, dict[str, Any], PlanError)
    assert len(str(error.value)) < 500
    assert str(error.value).isprintable()


def test_data_of_python_and_files_are_checked_alike(tmp_path: Path) -> None:
    assert convert({"name": "x", "count": 3}, Row, "row", PlanError) == Row("x", 3)
    with pytest.raises(PlanError, match="row: expected finite numbers, found nan"):
        convert({"name": "x", "weight": float("nan")}, Row, "row", PlanError)
    path = tmp_path / "row.json"
    path.write_text('{"name": "x"}')
    assert read_json(path, Row, PlanError) == Row("x")
    with pytest.raises(PlanError, match=r"row\.json: expected a readable file, found more than 5"):
        read_json(path, Row, PlanError, max_bytes=5)
    path.write_text("[[rows]]\nname = 'x'\n")
    assert read_toml(path, Table, PlanError) == Table([Row("x")])


def test_a_file_appears_whole_in_a_new_folder_with_the_usual_permissions(tmp_path: Path) -> None:
    path = tmp_path / "a" / "b.bin"
    with write_atomically(path) as file:
        file.write(b"half")
        assert not path.exists()
        file.write(b"whole")
    assert path.read_bytes() == b"halfwhole"
    assert list(path.parent.iterdir()) == [path]
    (tmp_path / "plain").touch()
    assert path.stat().st_mode == (tmp_path / "plain").stat().st_mode


def test_a_failure_leaves_the_old_file_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_space(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    path = tmp_path / "x.bin"
    path.write_bytes(b"old")
    monkeypatch.setattr(os, "fsync", no_space)
    with pytest.raises(OSError, match="No space"), write_atomically(path) as file:
        file.write(b"new")
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]
