"""How probable programs are before any demonstration: the shorter, the more probable.

A program is written down by choosing an expression for each place in it, and the words within it.
Its form, which is the program without selections and words, is probable too if it was seen before.
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
from magical.tasks.programs.goals import Goal, Together
from magical.tasks.programs.parsing import VOCABULARY
from magical.tasks.programs.places import Place
from magical.tasks.programs.selections import Selection

KINDS: tuple[type[Expression], ...] = (Selection, Place, Goal)
NEW_FORMS = 1.0  # how many programs of forms that were never seen are added to those seen

Form = tuple[tuple[str, ...], ...]  # of the goals that hold together: names of goal and place


@dataclass(frozen=True)
class Prior:
    """A distribution over programs; words are uniform.

    Attributes:
        counts: how often each expression was seen, by its name, to which one is added. With none,
            all expressions of a kind are equally probable.
        forms: how often each form was seen.
    """

    counts: Mapping[str, int] = field(default_factory=lambda: MappingProxyType({}))
    forms: Mapping[Form, int] = field(default_factory=lambda: MappingProxyType({}))

    @staticmethod
    def of(programs: Iterable[Goal]) -> "Prior":
        """The prior by the forms and expressions of programs."""
        seen = list(programs)
        counts = Counter(type(part).__name__ for each in seen for part in each.parts)
        return Prior(counts, Counter(map(form_of, seen)))

    def bits(self, program: Goal) -> float:
        """Minus the logarithm, to base 2, of a program's probability."""
        parts = [part for part in program.parts if isinstance(part, Selection)]
        words = sum(bits_of_words(part) for part in program.parts if part not in parts)
        return self.bits_of_form(form_of(program)) + words + sum(map(self.bits_of_part, parts))

    def bits_of_form(self, form: Form) -> float:
        """Bits of a form: as one of those seen, or as new and made of its expressions."""
        together = (len(form) - 1) * self.choice(Together)
        new = together + sum(self.choice(VOCABULARY[name]) for goal in form for name in goal)
        total = sum(self.forms.values()) + NEW_FORMS
        return -math.log2((self.forms.get(form, 0) + NEW_FORMS * 2.0**-new) / total)

    def bits_of_part(self, part: Expression) -> float:
        """Bits of an expression with its words, without those within it."""
        return self.choice(type(part)) + bits_of_words(part)

    def choice(self, kind: type[Expression]) -> float:
        """The bits of choosing a kind of selection, place or goal."""
        base = next(base for base in KINDS if issubclass(kind, base))
        among = [name for name, other in VOCABULARY.items() if issubclass(other, base)]
        total = sum(1 + self.counts.get(name, 0) for name in among)
        return math.log2(total / (1 + self.counts.get(kind.__name__, 0)))


def form_of(program: Goal) -> Form:
    """A program without selections and words; the order of goals together makes no difference."""
    if isinstance(program, Together):
        return tuple(sorted(form_of(program.first) + form_of(program.second)))
    parts = [p for p in program.parts if isinstance(p, Goal | Place)]
    return (tuple(type(part).__name__ for part in parts),)


def simple_expressions(base: type[Expression]) -> Iterator[Expression]:
    """All expressions of a kind whose fields are words."""
    for kind in VOCABULARY.values():
        words = _fields(kind)
        if issubclass(kind, base) and all(map(_is_word, words)):
            yield from (kind(*values) for values in product(*words))


def bits_of_words(part: Expression) -> float:
    """Bits of an expression's own words."""
    return sum(math.log2(len(words)) for words in _fields(type(part)) if _is_word(words))


def _fields(kind: Any) -> list[Any]:
    hints = get_type_hints(kind)
    return [hints[each.name] for each in fields(kind)]


def _is_word(kind: object) -> bool:
    return isinstance(kind, type) and issubclass(kind, StrEnum)
