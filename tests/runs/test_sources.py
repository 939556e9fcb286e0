"""What entries learned from, and the class that follows."""

import pytest

from magical.runs.sources import CLASSES, SOURCES, learned_from, learning_class


@pytest.mark.parametrize(
    ("used", "expected"),
    [
        (["demonstrations"], "P"),
        (["rendered states", "demonstrations"], "R"),
        (["demonstrations", "simulator"], "X"),
        (["demonstrations", "rendered states", "simulator"], "X"),
        (["demonstrations", "object parser"], "P"),
        (["demonstrations", "rendered states", "object parser"], "R"),
        (["demonstrations", "object parser", "benchmark prior"], "B"),
        (["demonstrations", "simulator", "benchmark prior"], "B"),
        (["benchmark prior"], ""),
        (["object parser"], ""),
        (["demonstrations", "interaction"], ""),
        (["demonstrations", "state"], ""),
        (["simulator"], ""),
        ([], ""),
    ],
)
def test_the_class_follows_from_what_was_used(used: list[str], expected: str) -> None:
    assert learning_class(used) == expected


def test_classes_are_of_known_sources() -> None:
    assert set(CLASSES.values()) <= set(SOURCES)


def test_what_was_used_is_in_one_order() -> None:
    details = {"learned_from": ["simulator", "demonstrations"]}
    assert learned_from(details) == ("demonstrations", "simulator")
    with pytest.raises(ValueError, match="rendered states, simulator, interaction"):
        learned_from({"learned_from": ["pictures"]})
