"""Values in messages and tables: short and printable, whatever a file from outside holds."""

from itertools import islice
from typing import Any

import numpy as np

MAX_LENGTH = 200  # characters of a value in a message
MAX_ITEMS = 8  # of a container
_INTEGER_BITS = 256  # of the longest integer that is written out


def quoted(value: Any, limit: int = MAX_LENGTH) -> str:
    """A value as text for a message, of at most `limit` characters.

    Strings and numbers are written as in Python, containers with their first items, and anything
    else as the name of its type. Containers within containers are not entered, so the cost is
    bounded for any value. Control characters and other unprintable ones are escaped.
    """
    value = value.item() if isinstance(value, np.generic) else value
    match value:
        case str() | bytes():
            text = repr(value[:limit])
        case int() if value.bit_length() > _INTEGER_BITS:
            text = f"<integer of {value.bit_length()} bits>"
        case None | int() | float():
            text = str(value)
        case np.ndarray():
            kind = f"{value.dtype.kind}{value.dtype.itemsize * 8}"
            text = f"<array of shape {value.shape}, {kind}>"
        case dict() | list() | tuple() | set() | frozenset():
            items = [_item(item) for item in islice(value, MAX_ITEMS)]
            if isinstance(value, dict):
                items = [f"{key}: {_item(value[k])}" for key, k in zip(items, value, strict=False)]
            more = [f"... ({len(value)} items)"] if len(value) > MAX_ITEMS else []
            around = {list: "[]", tuple: "()"}.get(type(value), "{}")
            text = f"{around[0]}{', '.join(items + more)}{around[1]}"
        case _:
            text = f"<{printable(type(value).__name__)}>"
    return _cut(text, limit)


def _item(value: Any) -> str:
    if isinstance(value, list | tuple | set | frozenset | dict):
        return f"<{type(value).__name__} of {len(value)}>"
    return quoted(value, 40)


def printable(text: str, limit: int = MAX_LENGTH) -> str:
    """Text without quotes around it, cut to `limit`, with unprintable characters escaped."""
    return _cut("".join(c if c.isprintable() else ascii(c)[1:-1] for c in text[: limit + 1]), limit)


def _cut(text: str, limit: int) -> str:
    return text if len(text) <= limit else f"{text[: limit - 3]}..."


def for_terminal(text: str) -> str:
    """Lines of text with escape sequences and other unprintable characters escaped."""
    return "\n".join(printable(line, len(line)) for line in text.split("\n"))


def decimals(value: float, digits: int = 2, sign: str = "") -> str:
    """A number for people, such as `−0.25`: with a minus sign instead of a hyphen, never `-0.00`.

    With `sign="+"`, numbers of at least 0 have a sign, too.
    """
    return f"{value:{sign}z.{digits}f}".replace("-", "−")
