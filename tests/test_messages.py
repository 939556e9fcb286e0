"""Values in error messages are short and printable, whatever they are."""

from typing import Any

import numpy as np
import pytest

from magical.messages import MAX_LENGTH, decimals, printable, quoted
from magical.scene import Colour


@pytest.mark.parametrize(
    ("value", "text"),
    [
        ("a", "'a'"),
        (-0.5, "-0.5"),
        (True, "True"),
        (None, "None"),
        (b"ab", "b'ab'"),
        (Colour.RED, "'red'"),
        (np.float64(0.5), "0.5"),
        ([1, "b", (2, 3)], "[1, 'b', <tuple of 2>]"),
        ({"a": [1], 2: None}, "{'a': <list of 1>, 2: None}"),
        (list(range(100)), "[0, 1, 2, 3, 4, 5, 6, 7, ... (100 items)]"),
        (np.zeros((3, 4)), "<array of shape (3, 4), f64>"),
        (object(), "<object>"),
    ],
)
def test_ordinary_values(value: Any, text: str) -> None:
    assert quoted(value) == text


def doubled(times: int) -> Any:
    """Nested pairs: small in memory, 2 ** times items when written out."""
    return (doubled(times - 1),) * 2 if times else ()


CYCLE: list[Any] = []
CYCLE.append(CYCLE)


@pytest.mark.parametrize(
    "value",
    [
        "\x1b[31mred\x07\r\n\u202e\ud800",
        "x" * 10_000_000,
        b"\x00" * 10_000_000,
        10**100_000,
        doubled(100),
        CYCLE,
        type("\x1b[31m" * 100, (), {})(),
        {"k" * 1000: "v" * 1000},
        ["\x1b" * 100] * 100,
    ],
    ids=range(9),
)
def test_untrusted_values_are_bounded_and_printable(value: Any) -> None:
    text = quoted(value)
    assert 0 < len(text) <= MAX_LENGTH
    assert text.isprintable()


def test_text_without_quotes() -> None:
    assert printable("a\x1b[31m name") == r"a\x1b[31m name"
    assert len(printable("x" * 1000)) <= MAX_LENGTH


def test_numbers_for_people_have_one_minus_sign_and_no_negative_zero() -> None:
    assert [decimals(value) for value in (-0.004, 0.004, -0.25)] == ["0.00", "0.00", "−0.25"]
    assert [decimals(value, sign="+") for value in (-0.004, 0.25)] == ["+0.00", "+0.25"]
    assert decimals(-0.25, 3) == "−0.250"
