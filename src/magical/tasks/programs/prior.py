"""How probable programs are before any demonstration: the shorter, the more probable.

A program is written down by choosing an expression for each place in it, and the words within it.
"""

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, fields
from enum import StrEnum
from itertools import product
from types import MappingProxyType
from typing import Any, get_type_hints

from magical.tasks.programs.expressions import Expression
from magical.tasks.programs.goals import Goal
from magical.tasks.programs.parsing import VOCABULARY
from magical.tasks.programs.places import Place
from magical.tasks.programs.selections import Selection

KINDS: tuple[type[Expression], ...] = (Selection, Place, Goal)


@dataclass(frozen=True)
class Prior:
    """A distribution over programs; words are uniform.

    Attributes:
        counts: how often each expression was seen, by its name, to which one is added. With none,
            all expressions of a kind are equally probable.
    """

    counts: Mapping[str, int] = field(default_factory=lambda: MappingProxyType({}))

    @staticmethod
    def of(programs: Iterable[Expression]) -> "Prior":
        """The prior by the expressions of programs."""
        return Prior(Counter(type(part).__name__ for each in programs for part in each.parts))

    def bits(self, program: Expression) -> float:
        """Minus the logarithm, to base 2, of a program's probability."""
        return sum(self.choice(type(part)) + _bits_of_words(type(part)) for part in program.parts)

    def choice(self, kind: type[Expression]) -> float:
        """The bits of choosing a kind of selection, place or goal."""
        base = next(base for base in KINDS if issubclass(kind, base))
        among = [name for name, other in VOCABULARY.items() if issubclass(other, base)]
        total = sum(1 + self.counts.get(name, 0) for name in among)
        return math.log2(total / (1 + self.counts.get(kind.__name__, 0)))


def simple_expressions(base: type[Expression]) -> Iterator[Expression]:
    """All expressions of a kind whose fields are words."""
    for kind in VOCABULARY.values():
        words = _fields(kind)
        if issubclass(kind, base) and all(map(_is_word, words)):
            yield from (kind(*values) for values in product(*words))


def _bits_of_words(kind: type[Expression]) -> float:
    return sum(math.log2(len(words)) for words in _fields(kind) if _is_word(words))


def _fields(kind: Any) -> list[Any]:
    hints = get_type_hints(kind)
    return [hints[each.name] for each in fields(kind)]


def _is_word(kind: object) -> bool:
    return isinstance(kind, type) and issubclass(kind, StrEnum)
