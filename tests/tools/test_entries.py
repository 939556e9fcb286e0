"""Submitted entries: accepted as they are in the repository, refused with the reason otherwise."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from tools import entries

SUBMITTED = "seek-colour"
SCORES, ENTRY = "runs/0/scores.csv", "runs/0/entry.json"


@pytest.fixture
def folder(root: Path, tmp_path: Path) -> Path:
    """A copy of an accepted entry, beside the examples that its policy is one of."""
    shutil.copytree(root / "examples", tmp_path / "examples")
    shutil.copytree(root / "entries" / SUBMITTED, tmp_path / "entries" / SUBMITTED)
    return tmp_path / "entries" / SUBMITTED


def edit(name: str, old: str, new: str) -> Callable[[Path], None]:
    """Change a file's text, then state its sum as it is now."""

    def change(folder: Path) -> None:
        text = (folder / name).read_text()
        (folder / name).write_text(text.replace(old, new))
        entries.describe(folder, {"runs/0": "policy.py:SeekColour"})

    return change


def end_the_process(folder: Path) -> None:
    (folder / "policy.py").write_text("import os\n\nos._exit(0)\n")
    entries.describe(folder, {"runs/0": "policy.py:SeekColour"})


def score_by_another_rule(folder: Path) -> None:
    last = (folder / SCORES).read_text().splitlines()[-1]
    edit(SCORES, last, last.rpartition(",")[0] + ",0.125")(folder)


def leave_the_folder(folder: Path) -> None:
    path = folder / entries.SUBMISSION
    submission = json.loads(path.read_text())
    submission["files"]["../../examples/third_party_policy.py"] = "0" * 64
    path.write_text(json.dumps(submission))


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda folder: (folder / SCORES).unlink(), f"{SCORES}: expected a file, found none"),
        (lambda folder: (folder / SCORES).write_text(""), f"{SCORES}: expected the SHA-256 sum"),
        (
            lambda folder: (folder / "weights.bin").write_bytes(b""),
            "weights.bin: expected in submission.json, or not at all",
        ),
        (lambda folder: (folder / entries.SUBMISSION).unlink(), "submission.json"),
        (leave_the_folder, "expected a path in the entry's folder"),
        (
            lambda folder: entries.describe(folder, {"runs/0": "../../examples/a.py:SeekColour"}),
            "runs/0: expected the policy in a file of submission.json, found ../",
        ),
        (
            lambda folder: entries.describe(folder, {"/tmp/other": ""}),
            "/tmp/other: expected an entry, found none",
        ),
        (edit(ENTRY, "1e-09", "0.0"), "runs/0: nudge 0, expected 1e-09"),
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


def test_the_accepted_entries_are_accepted(capsys: pytest.CaptureFixture[str]) -> None:
    assert entries.main([]) == 0
    assert capsys.readouterr().out == f"{SUBMITTED}: accepted\n"
