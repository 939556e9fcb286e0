"""The table of results in the README: rows of at least three runs, picked from the results."""

from collections.abc import Sequence
from pathlib import Path

import pytest

from magical.envs.seeds import evaluation_seed
from magical.evaluation import RolloutScore, environments
from magical.report.found import Found, Result
from tests.entries import entry_of
from tools import readme_tables

CLONING = "BC (MT)"


@pytest.fixture(autouse=True)
def shown(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(readme_tables, "SHOWN", (CLONING,))


def run(seed: int, score: float, by_protocol: bool, method: str = CLONING) -> Result:
    scores = [
        RolloutScore(env_id, i, evaluation_seed(i), score, score)
        for env_id in environments()
        for i in range(100 if by_protocol else 1)
    ]
    entry = entry_of(
        method,
        scores,
        observation="LoRes4E",
        horizon="appendix" if by_protocol else "published",
        nudge=1e-9 if by_protocol else 0.0,
        record={"training_seed": seed, "learned_from": ["demonstrations"]},
    )
    plan = readme_tables.ROOT / "studies/published_tables/results/bc-multi-human"
    folder = Path("leaderboard") if by_protocol else Path()
    return Result(plan / "runs" / f"{method}-{seed}" / folder, entry)


def rows(results: Sequence[Result]) -> list[tuple[str, str, int]]:
    found = readme_tables.result_rows(Found(results))
    return [(row.name, f"{row.standing.test_all.value:.2f}", row.num_runs) for row in found]


def test_a_row_with_fewer_than_three_runs_is_refused() -> None:
    two = [run(seed, 0.5, by_protocol=False) for seed in range(2)]
    with pytest.raises(SystemExit, match=r"BC \(MT\): expected 3 runs of each task, found 2"):
        rows(two)


def test_other_scores_stand_in_with_a_mark_until_three_runs_follow_the_protocol() -> None:
    exact = [run(seed, score, by_protocol=False) for seed, score in enumerate((0.1, 0.3, 0.5))]
    ranked = [run(seed, score, by_protocol=True) for seed, score in enumerate((0.9, 0.7, 0.5))]
    assert rows([*exact, ranked[0]]) == [("BC (MT)‡", "0.30", 3)]
    assert rows([*exact, *ranked]) == [("BC (MT)", "0.70", 3)]


def test_the_best_row_of_three_runs_is_shown_and_no_single_run() -> None:
    ranked = [run(seed, 0.5, by_protocol=True) for seed in range(3)]
    better = [run(seed, 0.6, by_protocol=True, method="better") for seed in range(3)]
    lucky = [run(0, 0.9, by_protocol=True, method="lucky")]
    first, second = readme_tables.result_rows(Found([*ranked, *better, *lucky]))
    assert (first.name, second.name, second.standing.track) == ("better", "BC (MT)", "P")
    plan = "studies/published_tables/plans/bc-multi-human.toml"
    assert second.command == f"magical run {plan} --demos human"
