"""Data from outside, checked once, where it enters: reads JSON and TOML as records.

A file or a message may hold anything: binary data, numbers of a million digits, data nested so
deeply that hashing, comparing or printing it overflows the stack. The functions here turn it into a
record of a given type, or raise the caller's error with a message of bounded length that names the
file (or other source of the data), the offending field, what was expected and what was found:

    plan.toml: methods[2].tasks: expected array, found 'MoveToCorner'

The type is a frozen dataclass, a `msgspec.Struct`, a union of tagged structs, a list or dict of
these, or `dict[str, Any]`. Ranges and lengths are declared in its fields
(`Annotated[int, msgspec.Meta(ge=0, le=100)]`); `__post_init__` checks what a type cannot express,
and its `ValueError` is reported with the field's name in front. A field that the type does not have
is refused, an integer is accepted as a float, and nothing else is converted.

- `parse_json`: from the text or bytes of a message.
- `read_json`, `read_toml`, `read_json_lines`: from a regular file of bounded size.
- `convert`: from plain data that has been parsed already.
"""

import dataclasses
import itertools
import math
import re
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import UnionType
from typing import Any, TypeVar

import msgspec

from magical.errors import MagicalError
from magical.files import open_regular, read_regular, reading
from magical.messages import MAX_LENGTH, printable, quoted

MAX_DEPTH = 32  # levels of nested lists and dicts
MAX_BITS = 512  # of an integer: its conversions to text and to float are cheap and defined
MAX_BYTES = 1 << 20  # of a JSON file, and of one line of JSON
MAX_TOML_BYTES = 1 << 16
MAX_TOML_LINE = 1000  # characters: time and memory grow with the square of a dotted key's length

T = TypeVar("T")
Kind = type[T] | UnionType  # for a union, `T` is what the result is assigned to


def parse_json(data: bytes | str, kind: Kind[T], what: str, error: type[MagicalError]) -> T:
    """A record from JSON.

    Args:
        data: the text; the caller has bounded its length.
        kind: the record's type, as described above.
        what: the source of the data, for instance a file's path; messages begin with it.
        error: the class of the error to raise.

    Raises:
        MagicalError: of the class `error`; the data are not UTF-8 or not JSON, are nested too
            deeply, hold a number that is too large or not finite, or do not fit the type.
    """
    try:
        plain = msgspec.json.decode(data)
    except (ValueError, RecursionError) as problem:
        raise error(
            f"{what}: expected JSON, found something else: {printable(str(problem))}"
        ) from problem
    return convert(plain, kind, what, error)


def read_json(
    path: Path, kind: Kind[T], error: type[MagicalError], *, max_bytes: int = MAX_BYTES
) -> T:
    """A record from a JSON file, which must be a regular file or a link to one.

    Args:
        path: the file.
        kind: the record's type, as described above.
        error: the class of the error to raise.
        max_bytes: the largest size that is read.

    Raises:
        MagicalError: of the class `error`; as in `parse_json`, or the file is missing, too large,
            not a regular file or cannot be read.
    """
    return parse_json(_read(path, max_bytes, error), kind, str(path), error)


def read_toml(path: Path, kind: Kind[T], error: type[MagicalError]) -> T:
    """A record from a TOML file; arguments and errors as in `read_json`."""
    data = _read(path, MAX_TOML_BYTES, error)
    try:
        text = data.decode()
        if max(map(len, text.split("\n"))) > MAX_TOML_LINE:
            raise ValueError(f"more than {MAX_TOML_LINE} characters in a line")
        plain = tomllib.loads(text)
    except (ValueError, RecursionError) as problem:
        raise error(
            f"{path}: expected TOML, found something else: {printable(str(problem))}"
        ) from problem
    return convert(plain, kind, str(path), error)


def read_json_lines(path: Path, kind: Kind[T], error: type[MagicalError]) -> Iterator[T]:
    """Records from a file with one JSON object per line, in order.

    A last line without a newline, which a crash has cut off, is left out. Arguments and errors as
    in `read_json`; a message names the line, and `MAX_BYTES` bounds each line.
    """
    with reading(path, error), open_regular(path, follow_links=True) as file:
        for number in itertools.count(1):
            line = file.readline(MAX_BYTES)
            if len(line) < MAX_BYTES and not line.endswith(b"\n"):
                return
            yield parse_json(line, kind, f"{path}: line {number}", error)


def convert(plain: Any, kind: Kind[T], what: str, error: type[MagicalError]) -> T:
    """A record from plain data, such as parsed JSON; arguments and errors as in `parse_json`."""
    try:
        check_plain(plain)
        record: T = msgspec.convert(plain, kind, str_keys=True)
        _check_fields(plain, record, "")
    except ValueError as problem:
        raise error(f"{what}: {_explained(problem, plain, kind)}") from problem
    return record


def check_plain(data: object) -> None:
    """Check that parsed JSON is safe to hash, compare, print and walk recursively.

    Raises:
        ValueError: it is nested more than `MAX_DEPTH` levels deep, or has a number that is not
            finite or has more than `MAX_BITS` bits.
    """
    level = [data]
    for _ in range(MAX_DEPTH):
        children: list[object] = []
        for item in level:
            if isinstance(item, dict):
                children.extend(item.values())
            elif isinstance(item, list):
                children.extend(item)
            elif isinstance(item, int | float) and not _is_ordinary(item):
                raise ValueError(f"expected finite numbers, found {quoted(item)}")
        if not children:
            return
        level = children
    raise ValueError(f"expected data nested at most {MAX_DEPTH} levels deep, found more")


def _is_ordinary(number: float) -> bool:
    return number.bit_length() <= MAX_BITS if isinstance(number, int) else math.isfinite(number)


def _read(path: Path, max_bytes: int, error: type[MagicalError]) -> bytes:
    with reading(path, error):
        return read_regular(path, max_bytes)


def _check_fields(plain: Any, record: Any, path: str) -> None:
    """Raise for a field in plain data that the record made from them does not have."""
    if isinstance(plain, list) and isinstance(record, list | tuple):
        for index, (item, made) in enumerate(zip(plain, record, strict=False)):
            _check_fields(item, made, f"{path}[{index}]")
    if not isinstance(plain, dict):
        return
    known = _fields(record)
    for name, item in plain.items():
        if name not in known and not isinstance(record, Mapping):
            raise ValueError(
                f"{path}: expected the fields {', '.join(known)}, found {quoted(name)}"
            )
        made = known.get(name)
        if made is not item:  # `Any` is kept unchanged, and holds no records
            _check_fields(item, made, f"{path}.{printable(name)}")


def _fields(record: Any) -> dict[str, Any]:
    """The fields of a record by their names in files, including the tag's, or a dict itself."""
    if isinstance(record, Mapping):
        return {str(name): value for name, value in record.items()}
    if isinstance(record, msgspec.Struct):
        tag = record.__struct_config__.tag_field
        named = ((field.encode_name, field.name) for field in msgspec.structs.fields(record))
        values = {name: getattr(record, attribute) for name, attribute in named}
        return values if tag is None else {tag: None, **values}
    if dataclasses.is_dataclass(record):
        return {field.name: getattr(record, field.name) for field in dataclasses.fields(record)}
    return {}


def _explained(problem: ValueError, plain: Any, kind: Kind[Any]) -> str:
    """`field: expected ..., found ...` from a message of msgspec."""
    text, _, path = str(problem).rpartition(" - at `")
    text, path = (text, path.rpartition("$")[2].rstrip("`")) if text else (path, "")
    steps = [name or index for name, index in _STEP.findall(path)]
    found = _found(plain, steps)
    if missing := re.fullmatch("Object missing required field `(.*)`", text):
        text = f"expected the field {missing[1]}, found {found}"
    elif wanted := re.fullmatch("Expected (.*?)(, got .*)?", text):
        text = f"expected {wanted[1].replace('`', '')}, found {found}"
    elif re.match("Invalid (enum )?value ", text):
        choices = ", ".join(map(quoted, _choices(msgspec.inspect.type_info(kind), steps)))
        text = f"expected one of {printable(choices)}, found {found}"
    return printable(f"{path}: {text}".lstrip(".: "), 3 * MAX_LENGTH)


_STEP = re.compile(r"\.([^.[]+)|\[(\d+|\.\.\.)\]")


def _found(value: Any, steps: list[str]) -> str:
    """The value that a path leads to, quoted; msgspec writes any key of a dict as `...`."""
    for step in steps:
        if isinstance(value, dict) and step in value:
            value = value[step]
        elif isinstance(value, list) and step.isdigit() and int(step) < len(value):
            value = value[int(step)]
        else:
            return "another value"
    return quoted(value)


def _choices(node: Any, steps: list[str]) -> Iterator[Any]:
    """The values of the enumeration, literal or tag that a path leads to in a type."""
    if isinstance(node, msgspec.inspect.UnionType):
        for member in node.types:
            yield from _choices(member, steps)
    elif not steps:
        yield from getattr(node, "values", ()) or getattr(node, "cls", ())
    elif hasattr(node, "fields"):
        if getattr(node, "tag_field", None) == steps[0]:
            yield node.tag
        for field in node.fields:
            if field.encode_name == steps[0]:
                yield from _choices(field.type, steps[1:])
    elif inner := getattr(node, "value_type", None) or getattr(node, "item_type", None):
        yield from _choices(inner, steps[1:])
