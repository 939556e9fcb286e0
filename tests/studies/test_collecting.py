"""Collecting what a plan's runs scored, and going on with the plan from that."""

import json
import re
import shutil
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from baselines.tests.experiments.conftest import Planned, execute
from magical.evaluation import Entry, Evaluation, environments, read_entry
from magical.evaluation.entry import ENTRY_FILE, SCORES_FILE, write_collection
from magical.plugins import import_user_module
from magical.report.found import search_results
from magical.report.leaderboard import make_leaderboard
from magical_baselines.experiments.plan import planned_runs, read_plan
from magical_baselines.experiments.status import read_status
from studies import collect as collect_results
from studies import restore as restore_results
from studies.generated_tasks.baselines import read_methods


@pytest.fixture
def copied(finished: Path, tmp_path: Path) -> Path:
    """Results of the tiny plan, to change."""
    return Path(shutil.copytree(finished, tmp_path / "runs"))


@pytest.fixture
def out(tmp_path: Path) -> Path:
    """Nothing collected yet."""
    return tmp_path / "results" / "tiny"


def change(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


def collect(source: Path, out: Path, plan: Path, **options: Any) -> list[str]:
    return list(collect_results.collect([source], out, plan, **options))


def files(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def entries(out: Path) -> dict[str, Entry]:
    return collect_results.Collected.read(out).entries


def known(out: Path) -> dict[str, Any]:
    """What the plan's file says was collected."""
    return dict(json.loads((out / "plan.json").read_text())["collected"])


def test_scores_are_collected_and_weights_are_not(
    copied: Path, tiny: Path, out: Path, planned: Planned
) -> None:
    for number, path in enumerate(sorted(copied.glob(f"runs/*/{ENTRY_FILE}"))):
        entry = json.loads(path.read_text())
        entry["record"]["commit"] = f"{number}bcdef0123"
        path.write_text(json.dumps(entry))
    (note,) = collect(copied, out, tiny)
    assert note == "note: runs of several commits: 1 of 0bcdef0, 1 of 1bcdef0"
    assert files(out).keys() == {"plan.json", "entries.json", "scores.csv.gz"}
    kept = {f"runs/{run.folder}": read_entry(copied / "runs" / run.folder) for run in planned()}
    assert entries(out) == kept
    found = known(out)
    assert found["version"] == search_results([out]).entries[0].version
    assert set(found["runs"]) == {run.folder for run in planned()}
    assert all(run["seconds"]["training"] > 0 for run in found["runs"].values())
    # Reports and the leaderboard read it.
    del kept[f"runs/{planned()[1].folder}"]
    write_collection(out, kept)
    assert [entry.method for entry in search_results([out]).entries] == ["BC tiny"]
    (rejected,) = make_leaderboard([out]).rejected
    assert any("without Jitter" in reason for reason in rejected.reasons)


def test_it_can_be_repeated_while_runs_go_on(
    copied: Path, tiny: Path, out: Path, planned: Planned
) -> None:
    first, second = (copied / "runs" / run.folder for run in planned())
    (second / "result.json").rename(second / "later.json")
    assert collect(copied, out, tiny) == ["missing: BC tiny, MoveToRegion, seed 1: not done"]
    (kept,) = entries(out).values()
    (second / "later.json").rename(second / "result.json")
    change(first / SCORES_FILE, ",0,", ",1,")  # is not read again
    assert collect(copied, out, tiny) == []
    assert len(entries(out)) == 2
    assert entries(out)[f"runs/{first.name}"] == kept
    after = files(out)
    assert collect(copied, out, tiny, test_evaluations=9) == []
    assert files(out) == after


def test_the_leaderboards_evaluation_is_made_once_and_collected(
    copied: Path, tiny: Path, out: Path, planned: Planned, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(collect_results, "Evaluation", partial(Evaluation, rollouts=2))
    first, second = (run.folder for run in planned())
    (copied / "runs" / second / "result.json").unlink()
    assert collect(copied, out, tiny)  # first without
    shutil.rmtree(out)
    collect(copied, out, tiny, leaderboard=True, test_evaluations=3)
    entry, run = entries(out)[f"runs/{first}/leaderboard"], entries(out)[f"runs/{first}"]
    assert (entry.method, entry.evaluated.nudge) == ("BC tiny", 1e-9)
    assert (entry.record.policy, len(entry.scores)) == (
        "..",
        2 * len(environments(["MoveToRegion"])),
    )
    assert entry.record.test_evaluations == run.record.test_evaluations == 3
    stated = replace(run.record, test_evaluations=None)
    assert replace(run, record=stated) == read_entry(copied / "runs" / first)
    assert len(read_methods([out])["BC tiny"]) == 1  # of the run, not of both evaluations
    monkeypatch.setattr(collect_results, "evaluate_run", None)
    collect(copied, out, tiny, leaderboard=True)


def test_what_cannot_be_used_is_left_out_with_its_reason(
    copied: Path,
    tiny: Path,
    out: Path,
    planned: Planned,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    first, second = (copied / "runs" / run.folder for run in planned())
    change(second / ENTRY_FILE, '"version": "', '"version": "9.')
    assert "expected an entry made by" in collect(copied, out, tiny)[0]
    shutil.rmtree(out)
    change(first / SCORES_FILE, "env_id", "environment")
    change(second / "result.json", '"done"', '"failed", "error": "no room"')
    (copied / "runs" / "another").mkdir()
    another, damaged, *missing = collect(copied, out, tiny)
    assert another == f"left out: {copied / 'runs' / 'another'}: not a run of {tiny}"
    assert damaged.startswith(f"left out: {first / SCORES_FILE}: expected the header")
    assert missing == [
        "missing: BC tiny, MoveToRegion, seed 0: not done",
        "missing: BC tiny, MoveToRegion, seed 1: no room",
    ]
    assert entries(out) == {}
    argv = [str(tmp_path), "--out", str(out), "--plan", str(tiny)]
    assert collect_results.main(argv) == 1
    assert "expected a results folder, found no plan.json" in capsys.readouterr().err


def test_runs_that_are_no_longer_the_plans_count_nowhere(
    copied: Path, tiny: Path, out: Path, planned: Planned
) -> None:
    first, second = (run.folder for run in planned())
    assert collect(copied, out, tiny) == []
    changed = tiny.with_name("changed.toml")
    changed.write_text(tiny.read_text().replace("seeds = [0, 1]", "seeds = [0]"))
    left_out, stale = collect(copied, out, changed)
    assert left_out.startswith("left out: ")
    assert stale == f"does not count any more: {out / 'runs' / second}: not a run of {changed}"
    assert set(known(out)["runs"]) == {first}
    assert [skipped.folder.name for skipped in search_results([out]).skipped] == [second]


def test_runs_with_earlier_names_and_options_are_the_plans(
    copied: Path, tiny: Path, out: Path, planned: Planned
) -> None:
    assert collect(copied, out, tiny) == []
    before, names = entries(out), [run.folder for run in planned()]
    text = (out / "plan.json").read_text().replace('"device": "auto",', '"gone": 1,')
    assert "gone" in text
    earlier = {name: f"{name}-0123456789" for name in names}
    for name in names:
        text = text.replace(name, earlier[name])
    (out / "plan.json").write_text(text)
    write_collection(
        out, {key.replace(n := key.split("/")[1], earlier[n]): e for key, e in before.items()}
    )
    assert collect(copied, out, tiny) == []
    assert entries(out) == before
    assert set(known(out)["runs"]) == set(names)


# Their augmented frames were rendered, their autoencoder was refined, or they changed settings of
# `object-bc`, as no run does now.
OTHERS = {
    *("bc-transformations", "held-out", "sequence-learners-hundred"),
    *("adversarial-human", "settings-adversarial"),
    *("object-bc-ablations", "object-bc-ablations-human"),
}


def test_all_that_was_collected_is_of_todays_plans(root: Path) -> None:
    for path in root.glob("studies/*/results/*/plan.json"):
        if path.parent.name in OTHERS:
            continue
        collected = collect_results.Collected(**json.loads(path.read_text())["collected"])
        plan = path.parents[2] / "plans" / f"{path.parent.name}.toml"
        for module in re.findall(r"^#.* --import (\S+)", plan.read_text(), re.MULTILINE):
            import_user_module(module)
        planned = {run.folder: run for run in planned_runs(read_plan(plan))}
        collected.adopt(planned)
        assert collected.runs.keys() <= planned.keys(), path


def test_a_plan_goes_on_where_it_was_collected(
    copied: Path,
    finished: Path,
    tiny: Path,
    out: Path,
    planned: Planned,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    first, second = (run.folder for run in planned())
    collect(copied, out, tiny)
    again, waiting = tmp_path / "again", ["done", "waiting"]
    assert restore_results.restore(out, again, again=1) == 1  # the runs of a seed are done again
    assert [run.state for run in read_status(again).runs] == waiting
    assert restore_results.main([str(out), "--out", str(again)]) == 1
    assert "expected a new folder" in capsys.readouterr().err
    shutil.rmtree(out)
    shutil.rmtree(again)
    assert restore_results.main([str(out), "--out", str(again)]) == 1
    assert "expected collected runs, found none" in capsys.readouterr().err
    (copied / "runs" / second / "result.json").unlink()
    collect(copied, out, tiny)
    assert restore_results.restore(out, again) == 1
    assert [run.state for run in read_status(again).runs] == waiting
    before = (out / "plan.json").read_bytes()
    left_out, missing = collect(again, out, tiny, leaderboard=True)
    assert left_out.startswith("left out: ")  # no weights to evaluate
    assert missing == "missing: BC tiny, MoveToRegion, seed 1: not done"
    assert (out / "plan.json").read_bytes() == before
    assert [run.folder for run in execute(planned(), again)] == [second]
    assert read_status(again).complete
    for name in (first, second):
        file = Path("runs") / name / "scores.csv"
        assert (again / file).read_bytes() == (finished / file).read_bytes()
