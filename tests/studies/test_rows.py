"""Which entries count, which do not and why, and what they are held against."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from magical import __version__
from magical.evaluation import environments
from magical.report.found import search_results
from studies.published_tables.rows import make_rows, published_row
from tests.report.conftest import WriteEntry


def scores(task: str, value: float, rollouts: int = 100) -> Mapping[str, list[float]]:
    """The same score in every rollout; the published code's rule gives half of it."""
    return {f"{i.task}-{i.variant}": [value] * rollouts for i in environments([task])}


@pytest.mark.parametrize(
    ("method", "published"),
    [
        ("BC (ST)", "BC (ST)"),
        ("BC (ST), scripted experts", "BC (ST)"),
        ("BC (ST, allo.)", "BC (ST, allo.)"),
        ("WGAIL-GP (ST)", "WGAIL-GP (ST)"),
        ("BC (ST) again", ""),
        ("BC", ""),
    ],
)
def test_a_method_is_held_against_the_row_that_its_name_begins_with(
    method: str, published: str
) -> None:
    assert published_row(method) == published


def test_runs_of_a_method_are_a_row_by_the_published_rule(
    tmp_path: Path, write_entry: WriteEntry
) -> None:
    kept = {"version": __version__}
    write_entry("a", "BC (ST)", scores("MoveToRegion", 1.0), seed=0, **kept)
    write_entry("b", "BC (ST)", scores("MoveToRegion", 0.5), seed=1, **kept)
    write_entry("c", "BC (ST)", scores("MoveToCorner", 0.5), seed=0, **kept)
    (row,), rejected = make_rows(search_results([tmp_path]))
    assert rejected == []
    assert (row.method, row.published, row.means.shape) == ("BC (ST)", "BC (ST)", (3, 12))
    assert list(dict.fromkeys(i.task for i in row.env_ids)) == ["MoveToCorner", "MoveToRegion"]
    region = [i for i in row.env_ids if i.task == "MoveToRegion"]
    assert row.on(region).tolist() == [[0.5] * 6, [0.25] * 6]
    assert row.runs_in(region[0]).tolist() == [0.5, 0.25]
    assert np.isnan(row.means).sum() == 3 * 12 - 3 * 6


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"version": "9.0.0"}, r"made by version 9\.0\.0 of this package"),
        ({"version": ""}, r"made by version \(not stated\)"),
        ({"nudge": 1e-9}, "nudge 1e-09, expected 0: published scores are of the exact scene"),
        ({"horizon": "300"}, "MoveToRegion with another horizon than 40 control steps"),
        ({"rollouts": 3}, "3 rollouts of each environment, expected 100"),
        ({"without": "TestAll"}, "MoveToRegion without All: all variants of a task are needed"),
        ({"seed": 1}, "the same run as .*good: each run counts once"),
    ],
)
def test_an_entry_that_cannot_count_is_listed_with_its_reason(
    tmp_path: Path, write_entry: WriteEntry, change: dict[str, Any], reason: str
) -> None:
    write_entry("good", "BC (ST)", scores("MoveToRegion", 1.0), seed=1, version=__version__)
    fields = {"version": __version__, "seed": 2, **change}
    given = dict(scores("MoveToRegion", 0.0, fields.pop("rollouts", 100)))
    if without := fields.pop("without", ""):
        del given[f"MoveToRegion-{without}"]
    write_entry("other", "BC (ST)", given, **fields)
    (row,), (rejected,) = make_rows(search_results([tmp_path]))
    assert row.means.tolist() == [[0.5] * 6]
    assert Path(rejected.folder).name == "other"
    assert len(rejected.reasons) == 1
    assert re.search(reason, rejected.reasons[0])


def test_runs_that_always_fail_are_not_copies(tmp_path: Path, write_entry: WriteEntry) -> None:
    for seed in (0, 1):
        given = scores("MoveToRegion", 0.0)
        write_entry(str(seed), "AL (ST)", given, seed=seed, version=__version__)
    (row,), rejected = make_rows(search_results([tmp_path]))
    assert (len(row.means), rejected) == (2, [])


def test_runs_of_a_row_learned_from_the_same_sources(
    tmp_path: Path, write_entry: WriteEntry
) -> None:
    given = scores("MoveToRegion", 1.0)
    for seed, (sources, whose, number) in enumerate(
        [
            (["demonstrations"], "10 (human)", 2),
            (["demonstrations"], "25 (expert)", 5),
            (["demonstrations", "simulator"], "10 (human)", 9),
        ]
    ):
        record = {"learned_from": sources, "demonstrations": whose, "test_evaluations": number}
        write_entry(str(seed), "mine", given, seed=seed, version=__version__, record=record)
    (row,), (rejected,) = make_rows(search_results([tmp_path]))
    assert (len(row.means), row.track) == (2, "P")
    assert row.statements == ("10 (human); 25 (expert)", 5)
    assert rejected.reasons == [
        f"learned from: demonstrations, simulator, but {tmp_path / '0'} of the same method has "
        "demonstrations"
    ]
