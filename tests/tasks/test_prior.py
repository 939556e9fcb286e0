"""How probable programs are."""

import math

import pytest

from magical.tasks.programs import VOCABULARY, Place, Selection, parse
from magical.tasks.programs.prior import Prior, simple_expressions


def count(kind: type) -> int:
    return sum(issubclass(other, kind) for other in VOCABULARY.values())


def test_every_choice_is_uniform_without_programs() -> None:
    bits = Prior().bits(parse("Exactly(WithColour('red'))"))
    goals = len(VOCABULARY) - count(Selection) - count(Place)
    assert bits == pytest.approx(math.log2(goals) + math.log2(count(Selection)) + math.log2(4))


def test_what_programs_have_often_is_more_probable() -> None:
    prior = Prior.of([parse("Exactly(WithColour('red'))")] * 3)
    red, star = parse("Exactly(WithColour('red'))"), parse("Exactly(WithShape('star'))")
    assert prior.bits(red) < Prior().bits(red)
    assert prior.bits(star) - prior.bits(red) == pytest.approx(2.0)  # one of four, and none


def test_simple_expressions_have_every_word() -> None:
    places = list(map(repr, simple_expressions(Place)))
    assert len(places) == len(set(places)) == 3 + 4 + 4
    assert "AtWall('left')" in places
