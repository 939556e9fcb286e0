"""Submitted entries: accepted as they are in the repository, refused with the reason otherwise."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from tools import entries

SUBMITTED = "seek-colour"
SCORES = "runs/0/scores.csv"


@pytest.fixture
def folder(root: Path, tmp_path: Path) -> Path:
    """A copy of an accepted entry, beside the examples that its policy is one of."""
    shutil.copytree(root / "examples", tmp_path / "examples")
    shutil.copytree(root / "entries" / SUBMITTED, tmp_path / "entries" / SUBMITTED)
    return tmp_path / "entries" / SUBMITTED


def described(folder: Path) -> None:
    """Write the sums of the files as they are now."""
    entries.describe(folder, {"runs/0": "policy.py:SeekColour"})


def lose_a_file(folder: Path) -> None:
    (folder / SCORES).unlink()


def change_a_file(folder: Path) -> None:
    path = folder / SCORES
    path.write_text(path.read_text() + "\n")


def add_a_file(folder: Path) -> None:
    (folder / "weights.bin").write_bytes(b"")


def leave_the_folder(folder: Path) -> None:
    path = folder / entries.SUBMISSION
    submission = json.loads(path.read_text())
    submission["files"]["../../examples/third_party_policy.py"] = "0" * 64
    path.write_text(json.dumps(submission))


def act_from_outside(folder: Path) -> None:
    entries.describe(folder, {"runs/0": "../../examples/third_party_policy.py:SeekColour"})


def name_a_run_outside(folder: Path) -> None:
    entries.describe(folder, {"/tmp/other": ""})


def break_the_protocol(folder: Path) -> None:
    path = folder / "runs/0/entry.json"
    path.write_text(path.read_text().replace("1e-09", "0.0"))
    described(folder)


def damage_the_schema(folder: Path) -> None:
    path = folder / "runs/0/entry.json"
    path.write_text(path.read_text().replace('"method"', '"name"'))
    described(folder)


def exaggerate(folder: Path) -> None:
    path = folder / SCORES
    header, *lines = path.read_text().splitlines()
    worse = [",".join([*line.split(",")[:3], "0.5", "0.5"]) for line in lines]
    path.write_text("\n".join([header, *worse]) + "\n")
    described(folder)


def end_the_process(folder: Path) -> None:
    (folder / "policy.py").write_text("import os\n\nos._exit(0)\n")
    exaggerate(folder)


def score_by_another_rule(folder: Path) -> None:
    path = folder / SCORES
    path.write_text(path.read_text().rpartition(",")[0] + ",0.125\n")
    described(folder)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lose_a_file, f"{SCORES}: expected a file, found none"),
        (change_a_file, f"{SCORES}: expected the SHA-256 sum"),
        (add_a_file, "weights.bin: expected in submission.json, or not at all"),
        (leave_the_folder, "expected a path in the entry's folder"),
        (act_from_outside, "runs/0: expected the policy in a file of submission.json, found ../"),
        (name_a_run_outside, "/tmp/other: expected an entry, found none"),
        (break_the_protocol, "runs/0: nudge 0, expected 1e-09"),
        (damage_the_schema, "runs/0: "),
        (exaggerate, "runs/0: not confirmed"),
        (end_the_process, "runs/0: magical verify ended without a result"),
        (score_by_another_rule, "expected equal scores by both rules"),
    ],
)
def test_a_wrong_entry_is_refused_with_the_reason(
    folder: Path, change: Callable[[Path], None], reason: str
) -> None:
    change(folder)
    found = entries.reasons(folder)
    assert any(reason in text for text in found), found


def test_an_entry_without_its_description_is_refused(folder: Path) -> None:
    (folder / entries.SUBMISSION).unlink()
    (found,) = entries.reasons(folder)
    assert "submission.json" in found


def test_the_accepted_entries_are_accepted(capsys: pytest.CaptureFixture[str]) -> None:
    assert entries.main([]) == 0
    assert capsys.readouterr().out == f"{SUBMITTED}: accepted\n"


@pytest.mark.parametrize(
    "argv",
    [["--describe", "runs/0=a.py:B"], ["typo", "--describe", "runs/0="], ["--describe", "x"]],
)
def test_only_one_entry_is_described_at_a_time(
    folder: Path, argv: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        entries.main(["--entries", str(folder.parent), *argv])
    assert "expected one NAME of a folder" in capsys.readouterr().err
    assert [path.name for path in folder.parent.iterdir()] == [SUBMITTED]
