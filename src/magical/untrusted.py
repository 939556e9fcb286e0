"""Values that come from outside: shown safely in messages, checked before they are used.

A file or a server may hold anything: text that controls a terminal, numbers of a million digits,
data nested so deeply that hashing, comparing or printing it overflows the stack.
"""

import math

MAX_SHOWN = 200  # characters of an untrusted value in a message
MAX_DEPTH = 32  # levels of nested lists and dicts
MAX_BITS = 512  # of an integer: its conversions to text and to float are cheap and defined


def printable(text: str, limit: int = MAX_SHOWN) -> str:
    """Text for a terminal: control characters are escaped, at most `limit` characters are kept."""
    escaped = "".join(
        c if c.isprintable() else c.encode("unicode_escape").decode() for c in text[:limit]
    )
    whole = len(text) <= limit and len(escaped) <= limit
    return escaped if whole else f"{escaped[: limit - 3]}..."


def quoted(value: object) -> str:
    """An untrusted value for a message: text and numbers by value, the rest by type and length.

    Nothing is hashed, compared or walked, and no `repr` of a container is taken.
    """
    if isinstance(value, str):
        return f"'{printable(value, MAX_SHOWN - 2)}'"
    if value is None or isinstance(value, bool | float):
        return repr(value)
    if isinstance(value, int):
        bits = value.bit_length()
        return repr(value) if bits <= MAX_BITS else f"an integer of {bits} bits"
    name = printable(type(value).__name__, 40)
    if isinstance(value, bytes | list | tuple | dict):
        return f"{name} of length {len(value)}"
    return f"value of type {name}"


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
