"""What methods lose between Demo and TestAll."""

import math
from pathlib import Path

import pytest

from magical import __version__
from magical.evaluation import environments, published_tasks
from magical.report.found import search_results
from studies.published_tables.generalisation import find_drops
from studies.published_tables.rows import make_rows
from tests.report.conftest import WriteEntry


def write_run(
    write_entry: WriteEntry,
    task: str,
    seed: int,
    demo: float,
    test_all: float,
    method: str = "mine",
) -> None:
    """Scores of a run; the published code's rule gives half of each."""
    values = {"Demo": demo, "TestAll": test_all}
    scores = {
        f"{i.task}-{i.variant}": [values.get(i.variant, 0.0)] * 100 for i in environments([task])
    }
    write_entry(
        f"{task}-{seed}",
        method,
        scores,
        seed=seed,
        version=__version__,
        horizon="published",
        record={
            "learned_from": ["demonstrations", "object parser"],
            "demonstrations": "3 of each task (dataset)",
            "test_evaluations": 2,
        },
    )


def test_published_means_are_the_papers() -> None:
    bc, gail = find_drops([])
    assert (bc.method, bc.track, gail.track) == ("BC (ST), published", "P", "")
    assert [bc.demo.value, bc.test_all.value] == pytest.approx([0.64, 0.19], abs=0.005)
    assert gail.gap.value == pytest.approx(0.53, abs=0.005)
    assert math.isnan(bc.gap.low)


def test_a_row_with_all_tasks_by_hand(tmp_path: Path, write_entry: WriteEntry) -> None:
    for number, task in enumerate(published_tasks()):
        write_run(write_entry, task, 0, 1.0, 0.1 * number)
        write_run(write_entry, task, 1, 0.8, 0.1 * number)
    write_run(write_entry, published_tasks()[0], 2, 1.0, 0.5, method="one task")
    rows, rejected = make_rows(search_results([tmp_path]))
    _, _, drop = find_drops(rows)
    assert rejected == []
    assert (drop.method, drop.track) == ("mine", "P")
    assert drop.statements == ("3 of each task (dataset)", 2)
    assert drop.demo.value == pytest.approx(0.45)
    assert drop.test_all.value == pytest.approx(0.175)
    assert drop.gap.value == pytest.approx(0.275)
    assert drop.gap.low < 0.275 < drop.gap.high
