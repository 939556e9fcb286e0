"""Evaluated runs in folders: which count, which share a row, and what rows are called."""

from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from magical.errors import ScoresError
from magical.evaluation import Entry, read_entry
from magical.evaluation.entry import write_collection
from magical.report.found import by_row, find_results, search_results
from magical.runs import write_json
from tests.report.conftest import WriteEntry, make_entry

LINE = {"MakeLine-Demo": [1.0, 0.0]}


def write_plan(folder: Path, *names: str) -> None:
    """Write the plan of runs in folders of these names, with the seeds 0, 1, and so on."""
    run = {"method": "a", "tasks": ["MakeLine"], "total": 1}
    runs = [{**run, "folder": name, "seed": seed} for seed, name in enumerate(names)]
    write_json(folder / "plan.json", {"runs": runs})


def counted(*folders: Path) -> list[str]:
    """The names of the folders whose entries count."""
    return [result.folder.name for result in find_results(folders).results]


def test_entries_are_found_at_any_depth_in_order(write_entry: WriteEntry, tmp_path: Path) -> None:
    for name in ("b/run", "a", "b/other/deep", "b/.hidden"):
        write_entry(name, name, LINE)
    assert counted(tmp_path) == ["a", "deep", "run"]
    assert counted(tmp_path / "b", tmp_path) == ["deep", "run", "a"]


def test_an_entry_belongs_to_the_run_beside_or_around_it(
    write_entry: WriteEntry, tmp_path: Path
) -> None:
    write_entry("own", "own", LINE, seed=1)
    write_entry("around/evaluation", "around", LINE)
    write_json(tmp_path / "around" / "config.json", {"seed": 2, "tasks": ["MakeLine"]})
    write_entry("inside", "inside", LINE, record={"policy": "run"})
    write_json(tmp_path / "inside" / "run" / "config.json", {"seed": 3, "tasks": ["MakeLine"]})
    write_entry("alone", "alone", LINE, record={"training_seed": 4})
    write_entry("around/random", "random", LINE, record={"policy": "random"})
    seeds = {result.entry.method: result.seed for result in find_results([tmp_path]).results}
    assert seeds == {"own": 1, "around": 2, "inside": 3, "alone": 4, "random": None}


def test_collections_are_read_like_folders(write_entry: WriteEntry, tmp_path: Path) -> None:
    folder = write_entry("a", "a", LINE)
    entry = read_entry(folder)
    write_collection(tmp_path / "many", {"runs/b": entry, "runs/old": entry})
    write_plan(tmp_path / "many", "b")
    (tmp_path / "damaged").mkdir()
    (tmp_path / "damaged" / "entries.json").write_text("{}")
    found = search_results([tmp_path])
    names = [result.folder.relative_to(tmp_path).as_posix() for result in found.results]
    assert names == ["a", "many/runs/b"]
    assert [item.folder.name for item in found.skipped] == ["damaged", "old"]
    write_collection(tmp_path, {"a": entry})  # what a collection has too counts once
    assert [item.folder for item in find_results([tmp_path]).skipped].count(folder) == 1


def test_damaged_entries_are_skipped_by_name(write_entry: WriteEntry, tmp_path: Path) -> None:
    bad = write_entry("bad", "bad", LINE)
    (bad / "scores.csv").write_text("nothing")
    (write_entry("deep", "deep", LINE) / "entry.json").write_text("[" * 100_000)
    (tmp_path / "half").mkdir()
    (tmp_path / "half" / "entry.json").write_text("{}")
    for folder, message in ((bad, "the header"), (tmp_path / "none", "a folder with")):
        with pytest.raises(ScoresError, match=f"expected {message}"):
            find_results([folder])
    write_entry("good", "good", LINE)
    found = find_results([tmp_path])
    assert [result.entry.method for result in found.results] == ["good"]
    assert [item.folder.name for item in found.skipped] == ["bad", "deep", "half"]
    assert "no scores.csv" in found.skipped[2].reason


def test_what_an_earlier_plan_left_is_skipped(write_entry: WriteEntry, tmp_path: Path) -> None:
    for name in ("runs/old", "runs/old/leaderboard", "runs/now", "runs/now/leaderboard"):
        write_entry(name, "bc", LINE)
    for name in ("noop-MakeLine", "random-MakeLine"):
        write_entry(f"references/{name}", name, LINE)
    write_plan(tmp_path, "now", "waiting")
    found = search_results([tmp_path])
    names = [path.folder.relative_to(tmp_path).as_posix() for path in found.skipped]
    assert names == ["runs/old", "runs/old/leaderboard"]  # no references are listed
    write_json(tmp_path / "plan.json", {"runs": [], "references": ["noop-MakeLine"]})
    assert [item.folder.name for item in search_results([tmp_path]).skipped] == ["random-MakeLine"]
    (tmp_path / "plan.json").write_text("{damaged")  # says nothing of any run
    assert not search_results([tmp_path]).skipped


def test_a_training_run_counts_once_in_a_row(write_entry: WriteEntry, tmp_path: Path) -> None:
    write_entry("a", "bc", LINE, seed=0, record={"date": "2050-01-01T00:00:00Z"})
    date = {"date": "2049-01-01T00:00:00Z"}  # the newer one counts
    write_entry("again", "bc", {"MakeLine-Demo": [0.0, 0.0]}, seed=0, record=date)
    write_entry("b", "bc", LINE, seed=1)  # equal scores, another run
    write_entry("nudged", "bc", LINE, seed=0, nudge=1e-9)  # another row
    write_entry("third", "mine", LINE)
    write_entry("third-alike", "mine", LINE)  # too few scores to tell
    found = find_results([tmp_path])
    assert counted(tmp_path) == ["a", "b", "nudged", "third", "third-alike"]
    ((folder, reason),) = found.skipped
    assert folder.name == "again"
    assert reason.endswith("a: each run counts only once in a table row")


@pytest.mark.parametrize("seed", [None, 0])
def test_of_two_evaluations_of_a_run_the_more_complete_one_counts(
    write_entry: WriteEntry, tmp_path: Path, seed: int | None
) -> None:
    scores = {"MakeLine-Demo": [0.0, 0.5, 1.0] * 30, "MakeLine-TestAll": [0.0, 1.0] * 45}
    write_entry("a-look", "m", {"MakeLine-Demo": scores["MakeLine-Demo"]}, seed=seed)
    write_entry("whole", "m", scores, seed=seed)
    assert counted(tmp_path) == ["whole"]


def test_copies_with_other_seeds_are_one_run(write_entry: WriteEntry, tmp_path: Path) -> None:
    telling = {"MakeLine-Demo": [i / 50 for i in range(50)]}
    perfect = {"MoveToRegion-Demo": [1.0] * 45 + [0.5] * 5}
    for seed in range(3):
        record = {"date": f"205{3 - seed}-01-01"}
        write_entry(f"copy{seed}", "bc", telling, seed=seed, record=record)
        write_entry(f"perfect{seed}", "bc", perfect, seed=seed)
    assert counted(tmp_path) == ["copy0", "perfect0", "perfect1", "perfect2"]


@pytest.mark.parametrize("key", ["demonstrations", "num_demos", "config"])
def test_runs_of_other_demonstrations_or_settings_are_other_runs(
    write_entry: WriteEntry, tmp_path: Path, key: str
) -> None:
    for name, number in (("a", 10), ("b", 25), ("c", 25)):
        stated = {} if key == "config" else {key: number if key == "num_demos" else f"{number}"}
        folder = write_entry(name, "m", LINE, record={"training_seed": 0, **stated})
        if key == "config":
            write_json(folder / "config.json", {"seed": 0, "augment": number})
    assert counted(tmp_path) == ["a", "b"]


def test_runs_of_the_same_policy_are_one_if_it_learns_nothing_or_has_a_folder(
    write_entry: WriteEntry, tmp_path: Path
) -> None:
    write_json(tmp_path / "run" / "config.json", {"algorithm": "bc"})  # a seed is not recorded
    for name, policy in (("a", "../run"), ("b", "../run"), ("c", "noop"), ("d", "noop")):
        write_entry(name, policy.strip("./"), LINE, record={"policy": policy})
    for number, policy in enumerate(("x.zip", "y.zip", "z.py:p", "z.py:p")):
        write_entry(f"e{number}", "mine", LINE, record={"policy": policy})
    assert counted(tmp_path) == ["a", "c", "e0", "e1", "e2", "e3"]


def labels(*entries: Entry) -> list[str]:
    """The label of each entry's row."""
    rows = by_row(enumerate(entries), lambda pair: pair[1])
    found = {number: label for label, row in rows.items() for number, _ in row}
    return [found[number] for number in range(len(entries))]


def entry(*tasks: str, rollouts: int = 100, method: str = "m", **fields: Any) -> Entry:
    return make_entry(method, {f"{task}-Demo": [0.0] * rollouts for task in tasks}, **fields)


def test_single_tasks_share_a_row_whatever_their_tasks_and_horizons() -> None:
    # Tasks with one horizon cannot be evaluated with the published one.
    runs = entry("ClusterColour", horizon="published"), entry("MoveToRegion"), entry("MakeLine")
    assert labels(*runs) == ["m"] * 3
    assert labels(*runs, entry("ClusterColour")) == ["m, horizon 240", "m", "m", "m"]


def test_a_label_says_what_differs_and_nothing_else() -> None:
    shown: dict[str, Any] = {"observation": "LoRes4E"}
    assert labels(entry("MakeLine", seed=3), entry("MakeLine", seed=3)) == ["m"] * 2
    found = labels(
        entry("MakeLine", **shown),
        entry("MakeLine", seed=1, rollouts=5, observation="LoRes4A"),
        entry("MakeLine", **shown, action_space="continuous"),
        entry("MakeLine", **shown, privileged=True),
        entry("MakeLine", **shown, nudge=1e-4),
        entry("MakeLine", method="m, LoRes4E"),  # named like a row
        entry("MakeLine", method="other", nudge=1e-4),
    )
    assert found == [
        "m, LoRes4E",
        "m, LoRes4A, 5 rollouts, seed 1",
        "m, LoRes4E, continuous",
        "m, LoRes4E, privileged",
        "m, LoRes4E, nudge 0.0001",
        "m, LoRes4E (2)",
        "other, nudge 0.0001",
    ]


@given(
    st.lists(
        st.builds(
            entry,
            st.sampled_from(["ClusterColour", "ClusterShape", "MakeLine"]),
            st.sampled_from(["ClusterColour", "MakeLine"]),
            rollouts=st.sampled_from([1, 2]),
            horizon=st.sampled_from(["appendix", "published", "240", "320"]),
            seed=st.sampled_from([0, 1]),
        ),
        max_size=8,
    )
)
def test_a_cell_holds_equal_evaluations_only(entries: list[Entry]) -> None:
    rows = by_row(entries, lambda found: found)
    assert sorted(map(id, entries)) == sorted(id(e) for row in rows.values() for e in row)
    for row in rows.values():
        for env_id in {score.env_id for found in row for score in found.scores}:
            on = [e.evaluated for e in row if env_id in e.evaluated.env_ids]
            steps = {env_id.task_spec.resolve_horizon(how.horizon) for how in on}
            settings = {tuple((how.settings | {"horizon": None}).items()) for how in on}
            assert (len(steps), len(settings)) == (1, 1)
