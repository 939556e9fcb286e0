"""The page of results: made from the results alone, and honest about what is not there."""

import csv
import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from magical import __version__
from magical.envs.seeds import evaluation_seed
from magical.evaluation import Entry, RolloutScore, environments
from magical.evaluation.entry import write_collection
from studies import pages
from studies.collect import Collected
from studies.plan_results import PLANS
from studies.published_tables.picture import write_picture
from tests.entries import entry_of

pytest.importorskip("matplotlib", reason="the report extra is not installed")


@pytest.fixture
def repository(tmp_path: Path, root: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A repository with the studies, and no results; the picture, which takes long, is left out."""
    monkeypatch.setattr(pages, "write_picture", lambda *_: None)
    without = shutil.ignore_patterns("results", "__pycache__")
    shutil.copytree(root / "studies", tmp_path / "studies", ignore=without)
    return tmp_path


def write_run(repository: Path, plan: str, method: str, task: str, seed: int, score: float) -> Path:
    """An entry of a plan's run as collected, with the same score everywhere."""
    entry = entry_of(method, rows_of([task], score), record={"training_seed": seed})
    (path,) = repository.glob(f"studies/*/plans/{plan}.toml")
    results = path.parents[1] / "results" / plan
    name = f"{task}-seed{seed}"
    run = {"folder": name, "method": method, "tasks": [task], "seed": seed, "total": 1}
    runs = [run]
    if results.exists():
        runs = [*json.loads((results / "plan.json").read_text())["runs"], run]
    seconds: dict[str, object] = {"seconds": {"training": 90.0, "evaluation": 30.0}}
    known = {str(each["folder"]): {**each, **seconds} for each in runs}
    collected = Collected(version=__version__, runs=known, failed={"another": "no room"})
    collected.entries = {**entries_of(results), f"runs/{name}": entry}
    results.mkdir(parents=True, exist_ok=True)
    collected.write(results, runs)
    return results / "runs" / name


def entries_of(results: Path) -> dict[str, Entry]:
    return Collected.read(results).entries


def rows_of(tasks: list[str] | None, score: float) -> list[RolloutScore]:
    return [
        RolloutScore(env_id, i, evaluation_seed(i), score, score)
        for env_id in environments(tasks)
        for i in range(100)
    ]


def change_entries(folder: Path, change: Callable[[str, dict[str, Entry]], None]) -> None:
    """Change the entries of a run's plan, given the run's key and all of them."""
    results = folder.parents[1]
    entries = entries_of(results)
    change(f"runs/{folder.name}", entries)
    write_collection(results, entries)


def made(repository: Path) -> dict[str, list[list[str]]]:
    """The rows of every generated table, by its name."""
    assert pages.main([], repository) == 0
    return {
        path.stem: list(csv.reader(path.read_text(encoding="utf-8").splitlines()))
        for path in repository.glob("studies/*/tables/*.csv")
    }


def starting(rows: list[list[str]], start: str) -> list[list[str]]:
    return [row for row in rows if row[0].startswith(start)]


def test_without_results_everything_is_not_run(repository: Path) -> None:
    tables = made(repository)
    for plan in PLANS:
        ((_, runs, *_, missing),) = [row for row in tables["runs"] if row[0] == plan]
        assert runs == f"0 of {missing.removesuffix(' not run')}"
    assert ["BC (ST)", "the same", "not run", "", "", "", ""] in tables["counts"]
    assert [row[0] for row in tables["gaps"][1:]] == ["BC (ST), published", "GAIL (ST), published"]
    for name in ("agreement", "orders", "cells", "others"):
        assert tables[name] == []
    assert len(tables["rejected"]) == 1
    claims = starting(tables["claims"], "augmentation helps BC:")
    assert [row[-2:] for row in claims] == [["not run", "–"]] * 2
    assert claims[0][2].startswith("+0.09 [")


def test_cells_by_hand(repository: Path) -> None:
    hundred, scripted = "BC (ST), 100 perturbed experts", "BC (ST), scripted experts"
    for seed, score in enumerate((0.9, 1.0)):
        write_run(repository, "bc-human", "BC (ST)", "MoveToRegion", seed, score)
        write_run(repository, "object-bc", "object-bc (ST)", "MoveToRegion", seed, score)
        write_run(repository, "bc-scripted", scripted, "MoveToRegion", seed, score - 0.25)
    write_run(repository, "bc-perturbed-100", hundred, "MoveToRegion", 0, 0.5)
    tables = made(repository)
    ((_, runs, hours, minutes, version, missing),) = [
        row for row in tables["runs"] if row[0] == "bc-human"
    ]
    assert (runs, hours, minutes) == ("2 of 40", "0.1", "2.0")
    assert (version, missing) == (__version__, "1 failed, 37 not run")
    # Demo: 0.95 less 0.89, over the root of (2 x 0.05^2 + 4 x 0.11^2) / 5.
    distance = (0.95 - 0.89) / np.sqrt((2 * 0.05**2 + 4 * 0.11**2) / 5)
    assert tables["cells"][1][:3] == [
        "BC (ST)", "MoveToRegion (2 runs)", f"0.95 ± 0.07; 0.89 ± 0.11; +{distance:.1f}"
    ]  # fmt: skip
    ((_, published, cells, _, within_two, below, above),) = [
        row for row in tables["counts"] if row[0] == "BC (ST)"
    ]
    assert (published, cells, below, above) == ("the same", "6", "0", "3")
    assert within_two.startswith("3 (")
    ((_, _, tasks, ours, *_, verdict), _) = starting(tables["agreement"], "BC (ST)")
    assert (tasks, ours) == ("MoveToRegion", "0.95 [0.63, 1.00]")  # 0.95 ± 6.31 x 0.05
    assert verdict == "open"
    # A row that was not published has a table of its own, and one beside its baseline.
    assert tables["others"][1][:3] == ["object-bc (ST)", "MoveToRegion", "0.95 ± 0.07"]
    assert not [row for name in ("cells", "counts") for row in tables[name] if "object" in row[0]]
    assert tables["baseline"][1:] == [["MoveToRegion (1 runs)", "0.95", "0.50", "0.95", "0.50"]]
    (change,) = starting(tables["variants"], "scripted experts")
    assert change[1] == "−0.25; [−0.55, +0.05]"  # 4.303 x 0.0707; two degrees of freedom


def test_methods_are_marked_and_entries_that_do_not_count_are_listed_by_reason(
    repository: Path,
) -> None:
    stated: dict[str, Any] = {"test_evaluations": 20}
    stated["learned_from"] = ("demonstrations", "benchmark prior")

    def state(key: str, entries: dict[str, Entry]) -> None:
        entries[key] = replace(entries[key], record=replace(entries[key].record, **stated))

    for plan, method in (
        ("bc-human", "BC (ST)"),
        ("bc-perturbed-100", "BC (ST), 100 perturbed experts"),
        ("object-bc", "object-bc (ST)"),
        ("adversarial-human", "GAIL (ST)"),
        ("object-networks-human", "BC of objects (ST), deep set, human"),
        ("bc-ablations-human", "BC (ST, allo.)"),
        ("program-bc-human", "program-bc (ST), human"),
    ):
        change_entries(write_run(repository, plan, method, "MoveToRegion", 0, 0.5), state)
    folder = write_run(repository, "bc-human", "BC (ST)", "MoveToCorner", 0, 0.5)
    write_run(repository, "bc-human", "BC (ST), mine", "MoveToRegion", 1, 0.5)

    def spoil(key: str, entries: dict[str, Entry]) -> None:
        entries[f"{key}/leaderboard"] = entries[key]
        entries[key] = replace(entries[key], version="9.0.0")

    change_entries(folder, spoil)
    tables = made(repository)
    for name in ("counts", "agreement", "orders", "cells", "baseline", "others"):
        assert "† [B]" in str(tables[name]), name
    for name in ("object-networks-human", "program-bc-human"):
        assert "human† [B] (1 run)" in str(tables[name])
    assert tables["leaderboard"] == []
    path, reasons = str(folder.relative_to(repository)), dict(tables["rejected"])
    foreign = reasons.pop("BC (ST), mine is a method of none of the plans")
    assert foreign == "studies"
    ranked = next(reason for reason in reasons if reason.startswith("nudge 0, expected 1e-09"))
    assert reasons.pop(ranked) == f"{path}/leaderboard"
    assert path in reasons.values()


def write_leaderboard_entry(folder: Path, score: float) -> None:
    """The leaderboard's evaluation of a run on all tasks."""
    record = {
        "training_seed": 0,
        "learned_from": ["demonstrations"],
        "demonstrations": "10 of each task (dataset)",
        "test_evaluations": 3,
    }

    def add(key: str, entries: dict[str, Entry]) -> None:
        how = {"observation": "LoRes4E", "nudge": 1e-9}
        scores = rows_of(None, score)
        entries[f"{key}/leaderboard"] = entry_of(entries[key].method, scores, record=record, **how)

    change_entries(folder, add)


def test_the_leaderboards_evaluations_are_ranked_and_shown_nowhere_else(repository: Path) -> None:
    folder = write_run(repository, "program-bc-human", "BC (ST)", "MoveToRegion", 0, 0.5)
    before = made(repository)
    write_leaderboard_entry(folder, 0.25)
    tables = made(repository)
    ((*row, demo, test_all, _, gap_rank),) = [
        row for row in tables["leaderboard"] if row[0].startswith("not ranked")
    ]
    few = "not ranked: fewer than 3 runs"
    assert row[:5] == [few, "BC (ST)†", "P", "10 of each task (dataset)", "3"]
    assert row[5:] == ["demonstrations", "rollouts of 1 run"]
    assert demo.startswith("0.25 [")
    assert test_all.startswith("0.25 [")
    assert gap_rank == "–"
    assert {**tables, "leaderboard": []} == {**before, "leaderboard": []}


def test_the_check_finds_a_page_or_a_picture_that_is_out_of_date(
    repository: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = repository / "studies" / "published_tables" / "README.md"
    page.write_text(page.read_text().replace("## Limits\n", "## Limits\n\nX.\n"))
    write_run(repository, "bc-human", "BC (ST)", "MoveToRegion", 0, 0.5)
    with monkeypatch.context() as patched:
        patched.setattr(pages, "write_picture", write_picture)
        assert pages.main([], repository) == 0
    assert "\n\nX.\n" in page.read_text()  # what is written by hand stays
    with Image.open(repository / "studies" / pages.PICTURE) as image:
        assert image.width == 980
    assert pages.main(["--check"], repository) == 0
    runs = page.with_name("tables") / "runs.csv"
    runs.write_text(runs.read_text().replace("1 of 40", "2 of 40"))
    assert pages.main(["--check"], repository) == 1
    write_run(repository, "bc-human", "BC (ST)", "MoveToRegion", 1, 0.5)
    before = page.read_text()
    assert pages.main(["--check"], repository) == 1
    assert page.read_text() == before
    assert pages.main([], repository) == 0  # without the picture
    assert pages.main(["--check"], repository) == 1
