"""Run folders as plain files."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from magical.errors import RunFolderError
from magical.runs import is_run, read_json
from magical.runs.folder import CHECKPOINT, CONFIG, METRICS, RECORD, opened_folder

CONFIGURATION: Mapping[str, Any] = {"algorithm": "bc", "demos": "demos", "seed": 0}


def open_once(path: Path, resume: bool = False, **changed: Any) -> None:
    with opened_folder(path, {**CONFIGURATION, **changed}, resume):
        pass


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    path = tmp_path / "run"
    open_once(path)
    return path


def test_a_new_folder_holds_configuration_and_versions(folder: Path, tmp_path: Path) -> None:
    assert is_run(folder)
    assert not is_run(tmp_path)
    assert json.loads((folder / CONFIG).read_text()) == CONFIGURATION
    assert {"magical", "python", "numpy"} <= read_json(folder / RECORD)["versions"].keys()


def test_a_run_is_continued_only_on_request_and_only_with_its_configuration(folder: Path) -> None:
    with pytest.raises(RunFolderError, match="holds this run already; add --resume"):
        open_once(folder)
    open_once(folder, resume=True)
    open_once(folder, resume=True, demos="elsewhere")
    for resume in (False, True):
        with pytest.raises(RunFolderError, match="another configuration: seed 0 there, 1 asked"):
            open_once(folder, resume, seed=1)


def test_settings_that_do_not_change_the_result_may_change(folder: Path) -> None:
    open_once(folder, resume=True, workers=3, log_every=1, checkpoint_every=7)


def test_a_folder_without_a_run_is_refused_and_left_as_it_is(tmp_path: Path) -> None:
    with pytest.raises(RunFolderError, match="expected a run to resume, found none"):
        open_once(tmp_path / "none", resume=True)
    (tmp_path / "thesis.tex").touch()
    for resume, message in ((False, "a new or an empty folder"), (True, "a run to resume")):
        with pytest.raises(RunFolderError, match=f"expected {message}"):
            open_once(tmp_path, resume)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


def test_a_locked_folder_is_refused_to_another_but_can_be_read(folder: Path) -> None:
    with opened_folder(folder, CONFIGURATION, resume=True):
        with pytest.raises(RunFolderError, match="another process already trains"):
            open_once(folder, resume=True)
        assert read_json(folder / CONFIG) == CONFIGURATION
    open_once(folder, resume=True)


def fail(folder: Path, file: str = METRICS, text: str = "") -> None:
    """Open a run, write one of its files, and fail."""
    with opened_folder(folder, CONFIGURATION, resume=is_run(folder)):
        (folder / file).write_text(text)
        raise ValueError("cannot begin")


@pytest.mark.parametrize(
    ("file", "text", "kept"),
    [
        (METRICS, "", False),
        (METRICS, "{}", True),
        (CHECKPOINT, "", True),
        ("thesis.tex", "", False),
    ],
)
def test_a_new_run_that_fails_before_it_begins_is_removed(
    tmp_path: Path, file: str, text: str, kept: bool
) -> None:
    with pytest.raises(ValueError, match="cannot begin"):
        fail(tmp_path / "run", file, text)
    assert is_run(tmp_path / "run") == kept
    open_once(tmp_path / "again")


def test_a_run_that_was_there_before_is_kept(folder: Path) -> None:
    with pytest.raises(ValueError, match="cannot begin"):
        fail(folder)
    assert is_run(folder)


def test_damaged_files_are_named(tmp_path: Path) -> None:
    (tmp_path / "damaged").write_text("{")
    (tmp_path / "list").write_text("[]")
    for name, problem in {
        "damaged": "expected JSON, found something else",
        "list": "expected object, found array",
        "missing": "expected a readable file, found No such file",
    }.items():
        with pytest.raises(RunFolderError, match=f"{name}: {problem}"):
            read_json(tmp_path / name)
