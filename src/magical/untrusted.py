"""Data from outside, checked once, where it enters: reads JSON and TOML as records.

The functions turn data that may hold anything into a record of a given type, or raise the caller's
error with a message that names the source, the field, what was expected and what was found:

    plan.toml: methods[2].tasks: expected array, found str

The type is a frozen dataclass, a `msgspec.Struct`, a union of tagged structs, a list or dict of
these, or `dict[str, Any]`. `Annotated[int, msgspec.Meta(ge=0)]` bounds a field; `__post_init__`
checks what a type cannot express. A field that the type does not have is refused.
"""

import dataclasses
import itertools
import math
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from types import UnionType
from typing import Any, TypeVar

import msgspec

from magical.errors import MagicalError
from magical.files import read_bounded, reading
from magical.messages import printable, quoted

MAX_DEPTH = 32  # levels of nested lists and dicts
MAX_BITS = 512  # of an integer: its conversions to text and to float are cheap and defined
MAX_BYTES = 1 << 20  # of a JSON file, and of one line of JSON
MAX_TOML_BYTES = 1 << 16
MAX_TOML_LINE = 1000  # characters: time and memory grow with the square of a dotted key's length

T = TypeVar("T")
Kind = type[T] | UnionType  # for a union, `T` is what the result is assigned to
Error = type[MagicalError]


def parse_json(data: bytes | str, kind: Kind[T], what: str, error: Error) -> T:
    """A record from JSON of bounded length; messages begin with `what`, the source of the data."""
    try:
        plain = msgspec.json.decode(data)
    except (ValueError, RecursionError) as problem:
        text = printable(str(problem))
        raise error(f"{what}: expected JSON, found something else: {text}") from problem
    return convert(plain, kind, what, error)


def read_json(path: Path, kind: Kind[T], error: Error, *, max_bytes: int = MAX_BYTES) -> T:
    """A record from a JSON file of at most `max_bytes`."""
    with reading(path, error):
        data = read_bounded(path, max_bytes)
    return parse_json(data, kind, str(path), error)


def read_toml(path: Path, kind: Kind[T], error: Error) -> T:
    """A record from a TOML file."""
    with reading(path, error):
        data = read_bounded(path, MAX_TOML_BYTES)
    try:
        text = data.decode()
        if max(map(len, text.split("\n"))) > MAX_TOML_LINE:
            raise ValueError(f"more than {MAX_TOML_LINE} characters in a line")
        plain = tomllib.loads(text)
    except (ValueError, RecursionError) as problem:
        text = printable(str(problem))
        raise error(f"{path}: expected TOML, found something else: {text}") from problem
    return convert(plain, kind, str(path), error)


def read_json_lines(path: Path, kind: Kind[T], error: Error) -> Iterator[T]:
    """Records from a file with one JSON object per line, each of at most `MAX_BYTES`.

    A last line without a newline, which a crash has cut off, is left out.
    """
    with reading(path, error), path.open("rb") as file:
        for number in itertools.count(1):
            line = file.readline(MAX_BYTES)
            if len(line) < MAX_BYTES and not line.endswith(b"\n"):
                return
            yield parse_json(line, kind, f"{path}: line {number}", error)


def convert(plain: Any, kind: Kind[T], what: str, error: Error) -> T:
    """A record from plain data, such as parsed JSON."""
    try:
        check_plain(plain)
        record: T = msgspec.convert(plain, kind, str_keys=True)
        _check_fields(plain, record, "")
    except ValueError as problem:
        text, _, path = str(problem).rpartition(" - at `$")
        text, path = (text, path.strip(".`") + ": ") if text else (path, "")
        text = text.replace("`", "").replace("Object missing required", "expected the")
        text = re.sub(r"^Expected (.*?)(, got (.*))?$", r"expected \1, found \3", text)
        raise error(printable(f"{what}: {path}{text.removesuffix(', found ')}", 800)) from problem
    return record


def check_plain(data: object) -> None:
    """Raise `ValueError` unless parsed JSON is safe to hash, compare, print and walk recursively.

    It may be nested at most `MAX_DEPTH` levels deep; its numbers are finite, of at most `MAX_BITS`.
    """
    level = [data]
    for _ in range(MAX_DEPTH):
        children: list[object] = []
        for item in level:
            if isinstance(item, dict | list):
                children.extend(item.values() if isinstance(item, dict) else item)
            elif (isinstance(item, int) and item.bit_length() > MAX_BITS) or (
                isinstance(item, float) and not math.isfinite(item)
            ):
                raise ValueError(f"expected finite numbers, found {quoted(item)}")
        if not children:
            return
        level = children
    raise ValueError(f"expected data nested at most {MAX_DEPTH} levels deep, found more")


def _check_fields(plain: Any, record: Any, path: str) -> None:
    """Raise for a field in plain data that the record made from them does not have."""
    if isinstance(plain, list) and isinstance(record, list | tuple):
        for index, (item, made) in enumerate(zip(plain, record, strict=False)):
            _check_fields(item, made, f"{path}[{index}]")
    if not isinstance(plain, dict) or plain is record:  # `Any` is kept, and holds no records
        return
    known = {str(key): value for key, value in record.items()} if isinstance(record, dict) else {}
    if dataclasses.is_dataclass(record):
        known = {field.name: getattr(record, field.name) for field in dataclasses.fields(record)}
    elif isinstance(record, msgspec.Struct):
        fields = msgspec.structs.fields(record)
        known = {field.encode_name: getattr(record, field.name) for field in fields}
        known[str(record.__struct_config__.tag_field)] = None
    for name, item in plain.items():
        if name not in known:
            expected = f"{path}: expected the fields {', '.join(known)}"
            raise ValueError(f"{expected}, found {quoted(name)}".lstrip(": "))
        _check_fields(item, known[name], f"{path}.{printable(name)}".lstrip("."))
