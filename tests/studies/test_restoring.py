"""Going on with a plan from what was collected of it, by `studies/restore.py`."""

import shutil
from pathlib import Path

import pytest

from baselines.tests.experiments.conftest import Planned, execute
from magical_baselines.experiments.status import read_status
from studies import collect as collect_results
from studies import restore as restore_results


def test_a_plan_goes_on_where_it_was_collected(
    finished: Path, tiny: Path, planned: Planned, tmp_path: Path
) -> None:
    copied = Path(shutil.copytree(finished, tmp_path / "runs"))
    first, second = (run.folder for run in planned())
    (copied / "runs" / second / "result.json").unlink()
    out, again = tmp_path / "results" / "tiny", tmp_path / "again"
    list(collect_results.collect([copied], out, tiny))
    assert restore_results.restore(out, again) == 1
    assert [run.state for run in read_status(again).runs] == ["done", "waiting"]
    before = (out / "plan.json").read_bytes()
    left_out, missing = collect_results.collect([again], out, tiny, leaderboard=True)
    assert left_out.startswith("left out: ")  # no weights to evaluate
    assert missing == "missing: BC tiny, MoveToRegion, seed 1: not done"
    assert (out / "plan.json").read_bytes() == before
    assert [run.folder for run in execute(planned(), again)] == [second]
    assert read_status(again).complete
    for name in (first, second):
        file = Path("runs") / name / "scores.csv"
        assert (again / file).read_bytes() == (finished / file).read_bytes()


def test_the_runs_of_a_seed_can_be_done_again(
    finished: Path, tiny: Path, planned: Planned, tmp_path: Path
) -> None:
    out, again = tmp_path / "results" / "tiny", tmp_path / "again"
    list(collect_results.collect([finished], out, tiny))
    assert restore_results.restore(out, again, again=1) == 1
    assert [run.state for run in read_status(again).runs] == ["done", "waiting"]


@pytest.mark.parametrize("exists", [False, True])
def test_what_cannot_be_restored_is_refused(
    finished: Path, tiny: Path, tmp_path: Path, exists: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "results" / "tiny"
    if exists:
        list(collect_results.collect([finished], out, tiny))
    argv = [str(out), "--out", str(tmp_path)]
    assert restore_results.main(argv) == 1
    expected = "expected a new folder" if exists else "expected collected runs, found none"
    assert expected in capsys.readouterr().err
