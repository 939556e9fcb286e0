"""Weights of a plan's runs for others, by `studies/weights.py`."""

import shutil
import zipfile
from dataclasses import replace
from pathlib import Path

import pytest
from baselines.baselines.baselines.tests.experiments.conftest import Planned

from magical.cli import main as magical
from magical.evaluation import read_entry
from studies import collect as collect_results
from studies import weights


@pytest.fixture
def results(finished: Path, tiny: Path, tmp_path: Path) -> Path:
    """What was collected of the tiny plan."""
    out = tmp_path / "results" / "tiny"
    list(collect_results.collect([finished], out, tiny))
    return out


def run(action: str, source: Path, results: Path, out: Path) -> int:
    return weights.main([action, str(source), "--results", str(results), "--out", str(out)])


def test_unpacked_runs_can_be_verified(
    finished: Path, results: Path, planned: Planned, tmp_path: Path
) -> None:
    archive, out = tmp_path / "tiny.zip", tmp_path / "weights"
    assert run("pack", finished, results, archive) == 0
    first = archive.read_bytes()
    assert run("pack", finished, results, archive) == 0
    assert archive.read_bytes() == first
    assert run("unpack", archive, results, out) == 0
    (folder,) = out.iterdir()
    assert folder.name == planned()[0].folder
    assert magical(["verify", str(folder), "--workers", "0"]) == 0
    whole = finished / "runs" / folder.name / "checkpoint.safetensors"
    assert (folder / whole.name).stat().st_size < whole.stat().st_size / 2  # without the optimiser
    assert str(tmp_path.parent) not in (folder / "config.json").read_text()


def test_weights_that_were_not_scored_are_refused(
    finished: Path,
    results: Path,
    planned: Planned,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    copied = Path(shutil.copytree(finished, tmp_path / "runs"))
    folder = copied / "runs" / planned()[0].folder
    entry = read_entry(folder)
    replace(entry, scores=[row._replace(score=0.5) for row in entry.scores]).write(folder)
    assert run("pack", copied, results, tmp_path / "tiny.zip") == 1
    assert "expected the collected scores, found others" in capsys.readouterr().err
    assert not (results / weights.WEIGHTS).exists()


def test_another_archive_is_refused(
    finished: Path, results: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    archive, out = tmp_path / "tiny.zip", tmp_path / "weights"
    assert run("unpack", archive, results, out) == 1
    assert "no weights were packed" in capsys.readouterr().err
    run("pack", finished, results, archive)
    with zipfile.ZipFile(archive, "a") as changed:
        changed.writestr("more", "")
    assert run("unpack", archive, results, out) == 1
    assert "expected tiny.zip with SHA-256" in capsys.readouterr().err
    assert not out.exists()


def test_a_seed_without_runs_has_no_weights(
    finished: Path, results: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    argv = ["pack", str(finished), "--results", str(results), "--out", str(tmp_path / "a.zip")]
    assert weights.main([*argv, "--seed", "9"]) == 1
    assert "expected collected runs of seed 9, found none" in capsys.readouterr().err
