"""Data that comes from outside, checked before it is used.

A file may hold anything: numbers of a million digits, data nested so deeply that hashing, comparing
or printing it overflows the stack. `magical.messages` shows such values in messages.
"""

import math

from magical.messages import quoted

MAX_DEPTH = 32  # levels of nested lists and dicts
MAX_BITS = 512  # of an integer: its conversions to text and to float are cheap and defined


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
