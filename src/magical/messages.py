"""Values in messages: short, printable, and safe whatever the value is."""

from collections.abc import Callable, Iterable
from itertools import islice
from typing import Any

import numpy as np

MAX_LENGTH = 200  # characters of a value in a message
MAX_ITEMS = 8  # of a container
_SHORT = 40  # characters of an item of a container
_INTEGER_BITS = 256  # of the longest integer that is written out
_BRACKETS: dict[type, tuple[str, str]] = {
    list: ("[", "]"),
    tuple: ("(", ")"),
    set: ("{", "}"),
    frozenset: ("{", "}"),
    dict: ("{", "}"),
}


def quoted(value: Any, limit: int = MAX_LENGTH) -> str:
    """A value as text for a message, whether or not it can be trusted.

    Strings and numbers are written as Python does, containers with their first items, and anything
    else as the name of its type. Containers within containers are not entered and no method of
    the value's own class is called, so the cost is bounded for any value. Control characters and
    others that cannot be printed are escaped.

    Args:
        value: any object.
        limit: the largest number of characters to return.
    """
    text = _container(value) if type(value) in _BRACKETS else _scalar(value, limit)
    return text if len(text) <= limit else f"{text[: limit - 3]}..."


def printable(text: str, limit: int = MAX_LENGTH) -> str:
    """A text without quotes around it, cut, and with what cannot be printed escaped."""
    shown = "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text[: limit + 1])
    return shown if len(shown) <= limit else f"{shown[: limit - 3]}..."


def _container(value: Any) -> str:
    opening, closing = _BRACKETS[type(value)]
    items: Iterable[str]
    if type(value) is dict:
        pairs = islice(value.items(), MAX_ITEMS)
        items = (f"{_item(key)}: {_item(item)}" for key, item in pairs)
    else:
        items = map(_item, islice(value, MAX_ITEMS))
    rest = f", ... ({len(value)} items)" if len(value) > MAX_ITEMS else ""
    return f"{opening}{', '.join(items)}{rest}{closing}"


def _item(value: Any) -> str:
    if type(value) in _BRACKETS:
        return f"<{type(value).__name__} of {len(value)}>"
    return quoted(value, _SHORT)


def _scalar(value: Any, limit: int) -> str:
    if value is None or isinstance(value, bool):
        return str(value)
    for kind, write in _WRITERS.items():
        if isinstance(value, kind):
            return write(value, limit)
    name = type.__dict__["__name__"].__get__(type(value))  # a metaclass could have its own
    return f"<{printable(name)}>"


def _string(value: Any, limit: int) -> str:
    if str.__len__(value) <= limit:
        return repr(str.__getitem__(value, slice(None)))
    return f"{str.__getitem__(value, slice(limit))!r}..."


def _bytes(value: Any, limit: int) -> str:
    return repr(bytes.__getitem__(value, slice(limit)))


def _integer(value: Any, limit: int) -> str:
    bits = int.bit_length(value)
    return int.__repr__(value) if bits <= _INTEGER_BITS else f"<integer of {bits} bits>"


def _array(value: Any, limit: int) -> str:
    shape = np.ndarray.shape.__get__(value)
    dtype = np.ndarray.dtype.__get__(value)
    return f"<array of shape {shape}, {dtype.kind}{dtype.itemsize * 8}>"


_WRITERS: dict[type, Callable[[Any, int], str]] = {
    str: _string,
    bytes: _bytes,
    int: _integer,
    float: lambda value, limit: float.__repr__(value),
    np.integer: lambda value, limit: repr(int(value)),
    np.floating: lambda value, limit: repr(float(value)),
    np.bool_: lambda value, limit: repr(bool(value)),
    np.ndarray: _array,
}
