"""How probable programs are before any demonstration: the shorter, the more probable.

A program is written down by choosing an expression for each place in it, and the words within it.
Every choice is uniform, so that the probability of a program is 2 to the minus its bits.
"""

import math
from collections.abc import Iterator
from enum import StrEnum
from itertools import product
from typing import TypeVar

from magical.tasks.programs.expressions import Expression, field_types
from magical.tasks.programs.parsing import KINDS, VOCABULARY

Kind = TypeVar("Kind", bound=Expression)


def bits(program: Expression) -> float:
    """Minus the logarithm, to base 2, of a program's probability."""
    return sum(map(bits_of_part, program.parts))


def bits_of_part(part: Expression) -> float:
    """Bits of an expression with its words, without those within it."""
    kinds = field_types(type(part)).values()
    return choice(type(part)) + sum(math.log2(len(k)) for k in kinds if issubclass(k, StrEnum))


def choice(kind: type[Expression]) -> float:
    """The bits of choosing a kind of selection, place or goal."""
    base = next(base for base in KINDS if issubclass(kind, base))
    return math.log2(sum(issubclass(other, base) for other in VOCABULARY.values()))


def simple_expressions(base: type[Kind]) -> Iterator[Kind]:
    """All expressions of a kind whose fields are words."""
    for kind in VOCABULARY.values():
        words = field_types(kind).values()
        if issubclass(kind, base) and all(issubclass(word, StrEnum) for word in words):
            yield from (kind(*values) for values in product(*words))
