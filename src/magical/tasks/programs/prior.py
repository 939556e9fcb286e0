"""The prior over programs, before any demonstration: the shorter, the more probable.

A program is written by choosing an expression for each slot, and the words within it. Every choice
is uniform, so a program of b bits has probability 2**-b.
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
    """The negative base-2 logarithm of a program's probability."""
    return sum(map(bits_of_part, program.parts))


def bits_of_part(part: Expression) -> float:
    """Bits of an expression and its words, without the expressions within it."""
    kinds = field_types(type(part)).values()
    return choice(type(part)) + sum(math.log2(len(k)) for k in kinds if issubclass(k, StrEnum))


def choice(kind: type[Expression]) -> float:
    """The bits of the choice of a kind of selection, place or goal."""
    base = next(base for base in KINDS if issubclass(kind, base))
    return math.log2(sum(issubclass(other, base) for other in VOCABULARY.values()))


def simple_expressions(base: type[Kind]) -> Iterator[Kind]:
    """All expressions of a kind whose fields, if any, are all words."""
    for kind in VOCABULARY.values():
        words = field_types(kind).values()
        if issubclass(kind, base) and all(issubclass(word, StrEnum) for word in words):
            yield from (kind(*values) for values in product(*words))
