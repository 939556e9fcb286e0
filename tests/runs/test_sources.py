"""What entries learned from, and the track that follows."""

import pytest

from magical.runs.sources import track_of


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
def test_the_track_follows_from_what_was_used(used: list[str], expected: str) -> None:
    assert track_of(used) == expected
