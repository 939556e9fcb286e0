"""How probable programs are."""

import math

import pytest

from magical.tasks import TASKS
from magical.tasks.programs import VOCABULARY, Place, Selection, parse
from magical.tasks.programs.prior import Prior, simple_expressions


def count(kind: type) -> int:
    return sum(issubclass(other, kind) for other in VOCABULARY.values())


def test_every_choice_is_uniform_without_programs() -> None:
    bits = Prior().bits(parse("Exactly(WithColour('red'))"))
    goals = len(VOCABULARY) - count(Selection) - count(Place)
    assert bits == pytest.approx(math.log2(goals) + math.log2(count(Selection)) + math.log2(4))


def test_what_programs_have_often_is_more_probable() -> None:
    red, star = parse("Exactly(WithColour('red'))"), parse("Exactly(WithShape('star'))")
    prior = Prior.of([red] * 3)
    assert prior.bits(red) < Prior().bits(red)
    assert prior.bits(star) - prior.bits(red) == pytest.approx(2.0)  # one of four, and none


def test_the_form_of_programs_that_were_seen_is_more_probable() -> None:
    out, stay = "Every(Mismatched(), OutOfRegions())", "Undisturbed(Matched())"
    seen = parse(f"Together({out}, {stay})")
    swapped, new = parse(f"Together({stay}, {out})"), parse(f"Together({out}, Only(Matched()))")
    prior = Prior.of([seen] * 3)
    assert prior.bits(seen) == pytest.approx(prior.bits(swapped))
    assert Prior(prior.counts).bits(seen) - prior.bits(seen) > 5.0
    assert prior.bits(new) > Prior(prior.counts).bits(new)  # what was seen leaves less for it


def test_probabilities_of_forms_sum_to_one_at_most() -> None:
    programs = [TASKS[name].program for name in TASKS]
    prior = Prior.of([each for each in programs if each is not None])
    forms = {*prior.forms, *((goal,) for form in prior.forms for goal in form)}
    assert sum(2.0 ** -prior.bits_of_form(form) for form in forms) <= 1.0


def test_simple_expressions_have_every_word() -> None:
    places = list(map(repr, simple_expressions(Place)))
    assert len(places) == len(set(places)) == 3 + 4 + 4
    assert "AtWall('left')" in places
