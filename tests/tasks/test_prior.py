"""How probable programs are."""

import math

import pytest

from magical.tasks.programs import VOCABULARY, Goal, Place, Selection, parse
from magical.tasks.programs.prior import bits, simple_expressions


def count(kind: type) -> int:
    return sum(issubclass(other, kind) for other in VOCABULARY.values())


def test_every_choice_is_uniform() -> None:
    found = bits(parse("Each(WithColour('red'), InRegion())"))
    choices = count(Goal) * count(Selection) * 4 * count(Place)  # of four colours
    assert found == pytest.approx(math.log2(choices))


def test_simple_expressions_have_every_word() -> None:
    places = list(map(repr, simple_expressions(Place)))
    assert len(places) == len(set(places)) == 3 + 4 + 4
    assert "AtWall('left')" in places
