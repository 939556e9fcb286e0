"""Files: bounded reading of what others wrote, and writing whole or not at all.

Readers turn data that may hold anything into a record of a given type, or raise the caller's error
with a message that names the source, the field, what was expected and what was found:

    plan.toml: methods[2].tasks: expected array, found str

The type is a frozen dataclass, a `msgspec.Struct`, a list or dict of these, or `dict[str, Any]`.
`Annotated[int, msgspec.Meta(ge=0)]` bounds a field; `__post_init__` checks what a type cannot
express. A field that a dataclass does not have is refused.
"""

import dataclasses
import errno
import hashlib
import json
import math
import os
import re
import secrets
import tomllib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import UnionType
from typing import IO, Any, TypeVar

import msgspec

from magical.errors import MagicalError
from magical.messages import printable, quoted

LOCK = ".lock"  # the lock of a folder
MAX_DEPTH = 32  # levels of nested lists and dicts
MAX_BITS = 512  # of an integer: its conversions to text and to float are cheap and defined
MAX_BYTES = 1 << 20  # of a JSON file
MAX_TOML_BYTES = 1 << 16
MAX_TOML_LINE = 1000  # characters: time and memory grow with the square of a dotted key's length

T = TypeVar("T")
Kind = type[T] | UnionType  # for a union, `T` is what the result is assigned to
Error = type[MagicalError]


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


def parse_json(data: bytes | str, kind: Kind[T], what: str, error: Error) -> T:
    """A record from JSON of bounded length; messages begin with `what`, the source of the data."""
    try:
        plain = msgspec.json.decode(data)
    except (ValueError, RecursionError) as problem:
        text = printable(str(problem))
        raise error(f"{what}: expected JSON, found something else: {text}") from problem
    return convert(plain, kind, what, error)


def convert(plain: Any, kind: Kind[T], what: str, error: Error) -> T:
    """A record from plain data, such as parsed JSON."""
    try:
        _check_plain(plain, MAX_DEPTH)
        record: T = msgspec.convert(plain, kind, str_keys=True)
        _check_fields(plain, record, "")
    except ValueError as problem:
        text, _, path = str(problem).rpartition(" - at `$")
        text, path = (text, path.strip(".`") + ": ") if text else (path, "")
        text = text.replace("`", "").replace("Object missing required", "expected the")
        text = re.sub(r"^Expected (.*?)(, got (.*))?$", r"expected \1, found \3", text)
        raise error(printable(f"{what}: {path}{text.removesuffix(', found ')}", 800)) from problem
    return record


def _check_plain(data: object, depth: int) -> None:
    """Raise `ValueError` unless parsed data is safe to compare, print and walk recursively."""
    if isinstance(data, dict | list):
        if depth == 0:
            raise ValueError(f"expected data nested at most {MAX_DEPTH} levels deep, found more")
        for item in data.values() if isinstance(data, dict) else data:
            _check_plain(item, depth - 1)
    elif (isinstance(data, int) and data.bit_length() > MAX_BITS) or (
        isinstance(data, float) and not math.isfinite(data)
    ):
        raise ValueError(f"expected finite numbers, found {quoted(data)}")


def _check_fields(plain: Any, record: Any, path: str) -> None:
    """Raise for a field in plain data that the record made from them does not have."""
    if isinstance(plain, list) and isinstance(record, list | tuple):
        for index, (item, made) in enumerate(zip(plain, record, strict=False)):
            _check_fields(item, made, f"{path}[{index}]")
    # `Any` is kept, and holds no records; a `Struct` checks its fields itself.
    if not isinstance(plain, dict) or plain is record or isinstance(record, msgspec.Struct):
        return
    known = {str(key): value for key, value in record.items()} if isinstance(record, dict) else {}
    if dataclasses.is_dataclass(record):
        known = {field.name: getattr(record, field.name) for field in dataclasses.fields(record)}
    for name, item in plain.items():
        if name not in known:
            expected = f"{path}: expected the fields {', '.join(known)}"
            raise ValueError(f"{expected}, found {quoted(name)}".lstrip(": "))
        _check_fields(item, known[name], f"{path}.{printable(name)}".lstrip("."))


def read_bounded(path: Path, max_bytes: int) -> bytes:
    """The contents of a file; raises `OSError` if it has more than `max_bytes`."""
    with path.open("rb") as file:
        size = os.fstat(file.fileno()).st_size
        if size > max_bytes:
            raise OSError(errno.EFBIG, f"more than {max_bytes} bytes", str(path))
        return file.read(size)  # allocates as many bytes as are asked for, whatever there is


@contextmanager
def reading(path: Path | str, error: Error) -> Iterator[None]:
    """A context for reading a file: an `OSError` in it is raised as the class `error`."""
    try:
        yield
    except OSError as problem:
        name, found = problem.filename or path, problem.strerror or problem
        raise error(f"{name}: expected a readable file, found {found}") from problem


def sha256_sum(path: Path) -> str:
    """The SHA-256 sum of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


@contextmanager
def write_atomically(path: Path | str) -> Iterator[IO[bytes]]:
    """Open a new file under a temporary name next to `path`; it is renamed if the block succeeds.

    Missing folders are created. If the block raises, nothing is left behind and an older file at
    `path` stays unchanged. If the machine crashes, the older or the new file is there, intact.
    """
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    temporary = target.with_name(f".{target.name}.{secrets.token_hex(4)}.part")
    try:
        with temporary.open("xb") as file:  # x: never an existing file or link
            yield file
        with temporary.open("r+b") as written:
            os.fsync(written.fileno())
        temporary.replace(target)
    finally:
        temporary.unlink(missing_ok=True)


def write_json(path: Path, data: Mapping[str, Any], indent: int = 2) -> None:
    """Write a JSON object, indented, atomically."""
    with write_atomically(path) as file:
        file.write((json.dumps(data, indent=indent) + "\n").encode())
