"""What entries say about trained policies."""

from types import SimpleNamespace
from typing import Any

import pytest

from magical.learning import algorithm_names, find_algorithm
from magical.runs.sources import SOURCES, track_of
from tests.learning.tiny_runs import tiny


def details_of(algorithm: str, **fields: object) -> dict[str, Any]:
    return tiny(find_algorithm(algorithm).config, "paper", **fields).training_details


@pytest.mark.parametrize("algorithm", algorithm_names())
def test_every_algorithm_says_what_it_learns_from(algorithm: str) -> None:
    details = details_of(algorithm, seed=3)
    assert details["algorithm"] == algorithm
    assert details["training_seed"] == 3
    assert details["learned_from"]


@pytest.mark.parametrize(
    ("algorithm", "fields", "expected"),
    [
        ("bc", {}, ("demonstrations",)),
        ("gail", {}, ("demonstrations", "interaction")),
        ("object-bc", {}, ("demonstrations", "object parser", "benchmark prior")),
        ("program-bc", {}, ("demonstrations", "object parser", "benchmark prior")),
        ("ppo", {}, ("interaction", "score")),
        ("dagger", {}, ("demonstrations", "interaction", "expert labels")),
        (
            "dagger",
            {"variants": ("Demo", "Layout"), "episodes": 2},
            ("demonstrations", "interaction", "expert labels", "test variants"),
        ),
    ],
)
def test_sources_by_algorithm(
    algorithm: str, fields: dict[str, object], expected: tuple[str, ...]
) -> None:
    assert set(details_of(algorithm, **fields)["learned_from"]) == set(expected)
    assert set(expected) <= set(SOURCES)


CHOSEN = SimpleNamespace(LEARNED_FROM=("benchmark prior",), HIDDEN=(8,), make_convolutions=print)


@pytest.mark.parametrize(
    ("network", "expected"),
    [
        (f"{__name__}:CHOSEN", ("demonstrations", "benchmark prior")),
        (
            "studies.intent.object_networks:DEEP_SET",
            ("demonstrations", "object parser", "benchmark prior"),
        ),
    ],
)
def test_a_network_says_what_it_was_made_from(network: str, expected: tuple[str, ...]) -> None:
    found = details_of("bc", network=network)["learned_from"]
    assert set(found) == set(expected)
    assert track_of(found) == "B"


def test_the_number_of_demonstrations_is_said() -> None:
    assert details_of("bc", num_demos=7)["demonstrations"] == "7 of each task"
    assert "demonstrations" not in details_of("ppo")
