"""The page of results: made from the results alone, and honest about what is not there."""

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


def made(repository: Path) -> str:
    assert pages.main([], repository) == 0
    return "".join(pages_of(repository).values())


def pages_of(repository: Path) -> dict[str, str]:
    return {n: (repository / "studies" / n / "README.md").read_text() for n in pages.SECTIONS}


def section(text: str, name: str) -> str:
    return text.partition(f"<!-- {name} -->\n")[2].partition("<!-- end -->")[0]


def lines(text: str, name: str, start: str) -> list[list[str]]:
    """The rows of a section's tables that begin with a text, as cells."""
    rows = [line.strip("| ").split(" | ") for line in section(text, name).splitlines()]
    return [row for row in rows if row[0].startswith(start)]


def test_without_results_everything_is_not_run(repository: Path) -> None:
    text = made(repository)
    for plan in PLANS:
        ((_, runs, *_, missing),) = lines(text, "runs", f"[{plan}](")
        assert runs == f"0 of {missing.removesuffix(' not run')}"
    assert lines(text, "counts", "BC (ST) ") == []
    assert "BC (ST) | the same | not run |" in section(text, "counts")
    assert [row[0] for row in lines(text, "gaps", "")[2:]] == [
        "BC (ST), published",
        "GAIL (ST), published",
    ]
    for name in ("tasks", "far", "agreement", "orders", "cells", "others"):
        assert section(text, name) == "Nothing yet: not run.\n"
    assert section(text, "rejected") == "None.\n"
    claims = lines(text, "claims", "augmentation helps BC:")
    assert [row[-2:] for row in claims] == [["not run", "–"]] * 2
    assert claims[0][2].startswith("+0.09 [")


def test_cells_by_hand(repository: Path) -> None:
    for seed, score in enumerate((0.9, 1.0)):
        write_run(repository, "bc-human", "BC (ST)", "MoveToRegion", seed, score)
        write_run(repository, "object-bc", "object-bc (ST)", "MoveToRegion", seed, score)
    text = made(repository)
    ((_, runs, hours, minutes, version, missing),) = lines(text, "runs", "[bc-human](")
    assert (runs, hours, minutes) == ("2 of 40", "0.1", "2.0")
    assert (version, missing) == (__version__, "1 failed, 37 not run")
    # Demo: 0.95 less 0.89, over the root of (2 x 0.05^2 + 4 x 0.11^2) / 5.
    distance = (0.95 - 0.89) / np.sqrt((2 * 0.05**2 + 4 * 0.11**2) / 5)
    ((_, demo, *_),) = lines(text, "cells", "MoveToRegion (2 runs)")
    assert demo == f"0.95 ± 0.07<br>0.89 ± 0.11<br>+{distance:.1f}"
    ((_, published, cells, _, within_two, below, above),) = [
        row for row in lines(text, "counts", "BC (ST)") if row[0] == "BC (ST)"
    ]
    assert (published, cells, below, above) == ("the same", "6", "0", "3")
    assert within_two.startswith("3 (")
    ((_, _, tasks, ours, *_, verdict), _) = lines(text, "agreement", "BC (ST)")
    assert (tasks, ours) == ("MoveToRegion", "0.95 [0.63, 1.00]")  # 0.95 ± 6.31 x 0.05
    assert verdict == "open"
    assert section(text, "far").startswith("- BC (ST), above: MoveToRegion All (+10.8), ")
    assert lines(text, "tasks", "MoveToCorner") == [["MoveToCorner", "not run"]]
    # A row that was not published has a table of its own.
    assert section(text, "others").startswith("### object-bc (ST)\n")
    assert lines(text, "others", "MoveToRegion")[0][1] == "0.95 ± 0.07"
    assert all("object-bc" not in section(text, name) for name in ("cells", "counts"))


def test_the_object_centred_learner_has_a_baseline_from_the_same_demonstrations(
    repository: Path,
) -> None:
    write_run(repository, "object-bc", "object-bc (ST)", "MoveToRegion", 0, 0.75)
    assert section(made(repository), "baseline") == "Nothing yet: not run.\n"
    hundred = "BC (ST), 100 perturbed experts"
    write_run(repository, "bc-perturbed-100", hundred, "MoveToRegion", 0, 0.5)
    found = lines(made(repository), "baseline", "MoveToRegion")
    assert found == [["MoveToRegion (1 runs)", "0.75", "0.50", "0.75", "0.50"]]


def test_every_table_of_methods_marks_test_evaluations_and_track(repository: Path) -> None:
    stated: dict[str, Any] = {"test_evaluations": 20}
    stated["learned_from"] = ("demonstrations", "benchmark prior")

    def state(key: str, entries: dict[str, Entry]) -> None:
        entries[key] = replace(entries[key], record=replace(entries[key].record, **stated))

    hundred = "BC (ST), 100 perturbed experts"
    for plan, method in (
        ("bc-human", "BC (ST)"),
        ("bc-perturbed-100", hundred),
        ("object-bc", "object-bc (ST)"),
        ("adversarial-human", "GAIL (ST)"),
        ("object-networks-human", "BC of objects (ST), deep set, human"),
        ("bc-ablations-human", "BC (ST, allo.)"),
        ("program-bc-human", "program-bc (ST), human"),
    ):
        folder = write_run(repository, plan, method, "MoveToRegion", 0, 0.5)
        change_entries(folder, state)
    text = made(repository)
    for name in ("counts", "tasks", "far", "agreement", "orders", "cells", "baseline", "others"):
        assert "† [B]" in section(text, name), name
    for name in ("object-networks-human", "program-bc-human"):
        assert "human† [B] (1 run)" in section(text, name)


def test_a_change_is_shown_variant_by_variant(repository: Path) -> None:
    scripted = "BC (ST), scripted experts"
    write_run(repository, "bc-human", "BC (ST)", "MoveToCorner", 0, 0.5)
    write_run(repository, "bc-scripted", scripted, "MoveToCorner", 0, 0.74)
    one = ["+0.24", "+0.24", "", "+0.24", "+0.24", "", "+0.24", "+0.24"]  # one run: no interval
    assert lines(made(repository), "variants", "scripted experts")[0][1:] == one
    write_run(repository, "bc-human", "BC (ST)", "MoveToCorner", 1, 0.5)
    write_run(repository, "bc-scripted", scripted, "MoveToCorner", 1, 0.76)
    two = [cell and "+0.25<br>[+0.12, +0.38]" for cell in one]
    assert [row[1:] for row in lines(made(repository), "variants", "")[2:]] == [two]


def test_entries_that_do_not_count_are_listed_by_reason(repository: Path) -> None:
    folder = write_run(repository, "bc-human", "BC (ST)", "MoveToRegion", 0, 0.5)
    write_run(repository, "bc-human", "BC (ST), mine", "MoveToRegion", 1, 0.5)

    def spoil(key: str, entries: dict[str, Entry]) -> None:
        entries[f"{key}/leaderboard"] = entries[key]
        entries[key] = replace(entries[key], version="9.0.0")

    change_entries(folder, spoil)
    text = made(repository)
    for name in ("cells", "leaderboard"):
        assert section(text, name) == "Nothing yet: not run.\n"
    other, ranked, foreign = section(text, "rejected").splitlines()
    path = folder.relative_to(repository)
    assert other.startswith(f"- `{path}`: made by version 9.0.0")
    assert foreign == "- `studies`: BC (ST), mine is a method of none of the plans"
    assert ranked.startswith(f"- `{path}/leaderboard`: nudge 0, expected 1e-09")


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


@pytest.mark.parametrize("plan", ["bc-human", "program-bc-human"])
def test_the_leaderboards_evaluations_are_ranked_and_shown_nowhere_else(
    repository: Path, plan: str
) -> None:
    folder = write_run(repository, plan, "BC (ST)", "MoveToRegion", 0, 0.5)
    before = made(repository)
    write_leaderboard_entry(folder, 0.25)
    text = made(repository)
    ((*row, demo, test_all, _, gap_rank),) = lines(text, "leaderboard", "not ranked")
    few = "not ranked: fewer than 3 runs"
    assert row[:5] == [few, "BC (ST)†", "P", "10 of each task (dataset)", "3"]
    assert row[5:] == ["demonstrations", "rollouts of 1 run"]
    assert demo.startswith("0.25 [")
    assert test_all.startswith("0.25 [")
    assert gap_rank == "–"
    assert text.replace(section(text, "leaderboard"), section(before, "leaderboard")) == before


def test_the_check_finds_a_page_or_a_picture_that_is_out_of_date(
    repository: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pages, "write_picture", write_picture)
    page = repository / "studies" / "published_tables" / "README.md"
    page.write_text(
        page.read_text().replace("## Why cells differ\n", "## Why cells differ\n\nX.\n")
    )
    assert "\n\nX.\n" in made(repository)  # what is written by hand stays
    assert pages.main(["--check"], repository) == 0
    write_run(repository, "bc-human", "BC (ST)", "MoveToRegion", 0, 0.5)
    before = pages_of(repository)
    assert pages.main(["--check"], repository) == 1
    assert pages_of(repository) == before
    picture = repository / "studies" / pages.PICTURE
    old = picture.read_bytes()
    made(repository)
    assert pages.main(["--check"], repository) == 0
    with Image.open(picture) as image:
        assert image.width == 980
    picture.write_bytes(old)
    assert pages.main(["--check"], repository) == 1
    made(repository)
    page.write_text(page.read_text().replace("1 of 40", "2 of 40"))
    assert pages.main(["--check"], repository) == 1
