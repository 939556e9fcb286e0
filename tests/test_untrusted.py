"""JSON and TOML from outside become records, or one error that names file, field and value."""

import json
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import pytest

from magical.errors import PlanError
from magical.untrusted import (
    MAX_BYTES,
    convert,
    parse_json,
    read_json,
    read_json_lines,
    read_toml,
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


class Start(msgspec.Struct, tag="start", frozen=True):
    seed: int | None


class Stop(msgspec.Struct, tag="stop", frozen=True):
    pass


Message = Start | Stop


def table(text: str | bytes) -> Table:
    return parse_json(text, Table, "file", PlanError)


def message(text: str) -> Message:
    return parse_json(text, Message, "message", PlanError)


def test_data_become_records() -> None:
    read = table('{"rows": [{"name": "x", "weight": 1, "letter": "b"}], "details": {"a": [1]}}')
    assert read == Table([Row("x", 0, 1.0, Letter.B)], details={"a": [1]})
    assert isinstance(read.rows[0].weight, float)
    assert message('{"type": "start", "seed": null}') == Start(None)
    assert parse_json("[1, {}]", list[Any], "file", PlanError) == [1, {}]
    assert parse_json('{"1": 2}', dict[int, int], "file", PlanError) == {1: 2}


MISFITS = {
    '{"rows": [{"name": "x"}, {"name": 5}]}': "file: rows[1].name: expected str, found int",
    '{"rows": [{}]}': "file: rows[0]: expected the field name",
    '{"rows": {"a": 1}}': "file: rows: expected array, found object",
    "[]": "file: expected object, found array",
    '{"rows": [{"name": "x", "count": 10}]}': "file: rows[0].count: expected int <= 9",
    '{"rows": [{"name": "x", "count": 1.0}]}': "file: rows[0].count: expected int, found float",
    '{"rows": [{"name": "x", "count": true}]}': "file: rows[0].count: expected int, found bool",
    '{"rows": [{"name": "x", "count": 7}]}': (
        "file: rows[0]: count: expected another number than 7"
    ),
    '{"rows": [{"name": "\\u001b\\n*****"}]}': ("file: rows[0].name: expected str of length <= 5"),
    '{"rows": [{"name": "x", "letter": "z"}]}': ("file: rows[0].letter: Invalid enum value 'z'"),
    '{"rows": [], "by_name": {"a": 3}}': ("file: by_name[...]: Invalid enum value 3"),
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


def test_unions_are_told_apart_by_their_tag() -> None:
    with pytest.raises(PlanError, match="type: Invalid value 'x'"):
        message('{"type": "x"}')
    with pytest.raises(PlanError, match="expected the fields type, found 'seed'"):
        message('{"type": "stop", "seed": 1}')


@contextmanager
def bounded_error(message: str, most: int) -> Iterator[None]:
    """The block raises one error, printable and shorter than `most`."""
    with pytest.raises(PlanError, match=message) as error:
        yield
    assert len(str(error.value)) < most
    assert str(error.value).isprintable()


NO_JSON = {
    "empty": b"",
    "cut off": b'{"rows": [',
    "not UTF-8": b'{"rows": [], "details": {"\xff": 1}}',
    "UTF-16": '{"rows": []}'.encode("utf-16"),
    "surrogate": b'{"rows": [], "details": {"a": "\\ud800"}}',
    "not finite": b'{"rows": [], "details": {"a": NaN}}',
    "too large a float": b'{"rows": [], "details": {"a": 1e400}}',
    "too long an integer": b'{"rows": [], "details": {"a": ' + b"1" * 100_000 + b"}}",
    "nested": b"[" * 100_000,
    "long": b'"' + b"\x1b" * MAX_BYTES,
}


@pytest.mark.parametrize("data", NO_JSON.values(), ids=NO_JSON)
def test_anything_but_json_is_one_bounded_printable_error(data: bytes) -> None:
    with bounded_error("^file: expected JSON, found something else", 500):
        table(data)


NO_TOML = {
    "malformed": b"a = [",
    "not UTF-8": b"a = '\xff'",
    "not finite": b"a = nan",
    "too long an integer": b"a = " + b"1" * 400,
    "nested": b"a = " + b"[" * 990,
    "nested tables": b"[" + b"a." * 400 + b"a]",
    "dotted key": b"a." * 30_000 + b"a = 1",
    "too large": b"# ...\n" * 20_000,
}


@pytest.mark.parametrize("data", NO_TOML.values(), ids=NO_TOML)
def test_anything_but_toml_is_one_bounded_printable_error(data: bytes, tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(data)
    with bounded_error(f"^{re.escape(str(path))}: expected ", 500):
        read_toml(path, dict[str, Any], PlanError)


@pytest.mark.parametrize("name", ["\x1b" * 50_000, " - at `$.x" * 50_000], ids=["\\x1b", "at"])
def test_messages_are_bounded(name: str) -> None:
    for data in (
        {"rows": [], name: 1},
        {"rows": [{"name": name}]},
        {"rows": [{"name": "x", "letter": name}]},
        {"rows": name},
    ):
        with bounded_error("^file: ", 900):
            table(json.dumps(data))
    with bounded_error("^file: ", 900):
        parse_json(json.dumps(name), Letter, "file", PlanError)


def test_data_of_python_are_checked_alike() -> None:
    assert convert({"name": "x", "count": 3}, Row, "row", PlanError) == Row("x", 3)
    with pytest.raises(PlanError, match="row: expected finite numbers, found nan"):
        convert({"name": "x", "weight": float("nan")}, Row, "row", PlanError)


def test_files(tmp_path: Path) -> None:
    path = tmp_path / "row.json"
    path.write_text('{"name": "x"}')
    assert read_json(path, Row, PlanError) == Row("x")
    with pytest.raises(PlanError, match=r"row\.json: expected a readable file, found more than 5"):
        read_json(path, Row, PlanError, max_bytes=5)
    with pytest.raises(PlanError, match=r"row\.json: expected TOML, found something else"):
        read_toml(path, Row, PlanError)
    path.write_text("[[rows]]\nname = 'x'\n")
    assert read_toml(path, Table, PlanError) == Table([Row("x")])


def test_lines(tmp_path: Path) -> None:
    path = tmp_path / "rows.jsonl"
    path.write_text('{"name": "x"}\n{"name": "y"}\n{"na')
    assert list(read_json_lines(path, Row, PlanError)) == [Row("x"), Row("y")]
    path.write_text('{"name": "x"}\n{"name": 1}\n')
    with pytest.raises(PlanError, match=r"rows\.jsonl: line 2: name: expected str, found int"):
        list(read_json_lines(path, Row, PlanError))
    path.write_text(" " * MAX_BYTES)
    with pytest.raises(PlanError, match="line 1: expected JSON, found something else"):
        list(read_json_lines(path, Row, PlanError))
