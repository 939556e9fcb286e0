"""Records of options: the parts of configurations, and how they are flattened."""

import dataclasses
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import MISSING, dataclass
from functools import cache
from typing import Any, TypeVar, get_origin, get_type_hints

import numpy as np

from magical.errors import InvalidConfigError, PluginError, UnknownNameError
from magical.messages import quoted
from magical.plugins import is_plugin
from magical.untrusted import convert

DEVICES = ("auto", "cpu", "cuda")
MAX_THREADS = 4096  # of a CPU
Check = tuple[Callable[[float], bool], str]
POSITIVE: Check = (lambda number: number > 0, "a number above 0")
NOT_NEGATIVE: Check = (lambda number: number >= 0, "at least 0")
BELOW_1: Check = (lambda number: 0 <= number < 1, "a number from 0 to below 1")
FRACTION: Check = (lambda number: 0 <= number <= 1, "a number from 0 to 1")
Part = TypeVar("Part", bound="Settings")
# The types of a class's fields, cached: each call would evaluate every annotation again.
type_hints: Callable[[Any], dict[str, Any]] = cache(get_type_hints)


def option(
    default: Any,
    text: str,
    check: Check | None = None,
    *,
    choices: tuple[str, ...] | Callable[[], tuple[str, ...]] = (),
    others: str = "",
    parse: Callable[[str], object] | None = None,
    metavar: str | None = None,
    name: str | None = None,
) -> Any:
    """A configuration field.

    Args:
        default: the published setting.
        text: one line of command-line help.
        check: the condition that numbers must meet, and how messages describe it.
        choices: the allowed values, if there are only a few, or a function that returns them.
        others: the group of entry points whose names are also allowed, as is `module:NAME`.
        parse: called with the value; raises an error unless it is allowed.
        metavar: the placeholder for the value in command-line help.
        name: the option's name, if the field's would be ambiguous outside its record.
    """
    metadata = {
        "help": text,
        "check": check,
        "choices": choices if callable(choices) else lambda: choices,
        "others": others,
        "parse": parse,
        "metavar": metavar,
        "name": name,
    }
    return dataclasses.field(default=default, metadata=metadata)


@dataclass(frozen=True, kw_only=True)
class Settings:
    """A record of options: a part of a configuration, or a configuration.

    Paths are converted to strings, NumPy's numbers to Python's, and for tuple fields any iterable
    or a single string to a tuple, so that a record can be written as JSON.
    """

    def __post_init__(self) -> None:
        hints = type_hints(type(self))
        for field in dataclasses.fields(self):
            if field.metadata:
                value = _plain(getattr(self, field.name), hints[field.name])
                value = convert(value, hints[field.name], name_of(field), InvalidConfigError)
                object.__setattr__(self, field.name, value)
                _check_value(field, value)


def _plain(value: Any, hint: Any) -> Any:
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if get_origin(hint) is not tuple or not isinstance(value, Iterable):
        return value
    return (value,) if isinstance(value, str) else tuple(value)


def _check_value(field: "dataclasses.Field[Any]", value: Any) -> None:
    """Raise `InvalidConfigError` or `UnknownNameError` unless the field allows the value."""
    name, choices = name_of(field), field.metadata["choices"]()
    others = field.metadata["others"]
    if choices and value not in choices and not (others and is_plugin(others, value)):
        raise UnknownNameError(
            f"{name} {quoted(value)} is unknown; expected one of: {', '.join(choices)}"
            + ("; or module:NAME" if others else "")
        )
    if field.metadata["parse"]:
        field.metadata["parse"](value)
    if field.metadata["check"] and value is not None:
        is_right, expected = field.metadata["check"]
        if not is_right(value):
            raise InvalidConfigError(f"{name}: expected {expected}, found {quoted(value)}")


def all_fields(kind: type[Settings]) -> Iterator[tuple[str, "dataclasses.Field[Any]", Any]]:
    """Yield for each option the field name of its record, its own field and its type.

    The record's name is empty for the class's own fields. Raises `PluginError` for a class that
    cannot be turned into options.
    """
    places: dict[str, str] = {}
    for part, field, hint in _fields(kind):
        place = f"{kind.__name__}.{part}{'.' if part else ''}{field.name}"
        if not field.metadata:
            raise PluginError(
                f"{place}: expected option(...), or in the configuration itself a record of "
                f"options, found {hint}"
            )
        if other := places.get(name_of(field)):
            raise PluginError(
                f"{place}: expected another name than {other} has as an option; give option() a "
                "name"
            )
        places[name_of(field)] = place
        yield part, field, hint


def _fields(kind: type[Settings]) -> Iterator[tuple[str, "dataclasses.Field[Any]", Any]]:
    """The class's own fields and those of its records."""
    hints = type_hints(kind)
    for field in dataclasses.fields(kind):
        record = hints[field.name]
        if not field.metadata and isinstance(record, type) and issubclass(record, Settings):
            for inner in dataclasses.fields(record):
                yield field.name, inner, type_hints(record)[inner.name]
        elif field.name != "algorithm":
            yield "", field, record


def name_of(field: "dataclasses.Field[Any]") -> str:
    """The name of a field's option."""
    return field.metadata["name"] or field.name


def by_part(
    kind: type[Settings], settings: Mapping[str, Any]
) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
    """Split settings, by option name, into the class's own fields and those of each record."""
    places = {name_of(field): (part, field.name) for part, field, _ in all_fields(kind)}
    own: dict[str, Any] = {}
    parts: dict[str, dict[str, Any]] = {}
    for name, value in settings.items():
        if name == "algorithm":
            own[name] = value
        elif name in places:
            part, field = places[name]
            (parts.setdefault(part, {}) if part else own)[field] = value
        else:
            raise UnknownNameError(
                f"setting {quoted(name)} is unknown; expected one of: {', '.join(places)}"
            )
    return own, parts


def default_of(field: "dataclasses.Field[Any]") -> Any:
    """The default of a field that holds a record; `None` if it has none."""
    return None if field.default_factory is MISSING else field.default_factory()
