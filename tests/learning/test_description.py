"""What entries say about trained policies."""

import pytest

pytest.importorskip("torch", reason="the learning extra is not installed")

from magical.learning import Config, algorithm_names, find_algorithm
from magical.learning.config import options
from magical.runs.sources import SOURCES, learned_from


def config(algorithm: str, **fields: object) -> Config:
    kind = find_algorithm(algorithm).config
    required = {"demos": "demos"} if "demos" in {o.name for o in options(kind)} else {}
    return kind.preset("paper", tasks=("MoveToRegion",), **required, **fields)


@pytest.mark.parametrize("algorithm", algorithm_names())
def test_every_algorithm_says_what_it_learns_from(algorithm: str) -> None:
    details = config(algorithm, seed=3).training_details
    assert details["algorithm"] == algorithm
    assert details["training_seed"] == 3
    assert learned_from(details)


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
            {"variants": ("Demo", "Layout")},
            ("demonstrations", "interaction", "expert labels", "test variants"),
        ),
    ],
)
def test_sources_by_algorithm(
    algorithm: str, fields: dict[str, object], expected: tuple[str, ...]
) -> None:
    assert learned_from(config(algorithm, **fields).training_details) == expected
    assert set(expected) <= set(SOURCES)


def test_the_number_of_demonstrations_is_said() -> None:
    assert config("bc", num_demos=7).training_details["demonstrations"] == "7 of each task"
    assert "demonstrations" not in config("ppo").training_details
