"""Run folders as plain files."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from magical.errors import RunFolderError
from magical.runs import is_run, open_folder, read_json
from magical.runs.folder import CONFIG, RECORD

CONFIGURATION: Mapping[str, Any] = {"algorithm": "bc", "demos": "demos", "seed": 0}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    path = tmp_path / "run"
    open_folder(path, CONFIGURATION, resume=False)
    return path


def test_a_new_folder_holds_configuration_and_versions(folder: Path, tmp_path: Path) -> None:
    assert is_run(folder)
    assert not is_run(tmp_path)
    assert json.loads((folder / CONFIG).read_text()) == CONFIGURATION
    assert {"magical", "python", "numpy"} <= read_json(folder / RECORD)["versions"].keys()


def test_a_run_is_continued_only_on_request_and_only_with_its_configuration(folder: Path) -> None:
    with pytest.raises(RunFolderError, match="holds this run already; add --resume"):
        open_folder(folder, CONFIGURATION, resume=False)
    open_folder(folder, CONFIGURATION, resume=True)
    open_folder(folder, {**CONFIGURATION, "demos": "elsewhere"}, resume=True)
    for resume in (False, True):
        with pytest.raises(RunFolderError, match="another configuration: seed 0 there, 1 asked"):
            open_folder(folder, {**CONFIGURATION, "seed": 1}, resume=resume)


def test_a_folder_without_a_run_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RunFolderError, match="expected a run to resume, found none"):
        open_folder(tmp_path / "none", CONFIGURATION, resume=True)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.tex").write_text("...")
    with pytest.raises(RunFolderError, match="expected a new or an empty folder"):
        open_folder(tmp_path / "mine", CONFIGURATION, resume=False)


@pytest.mark.parametrize(("text", "found"), [("{", "Expecting property"), ("[]", "list")])
def test_damaged_files_are_named(tmp_path: Path, text: str, found: str) -> None:
    (tmp_path / CONFIG).write_text(text)
    with pytest.raises(RunFolderError, match=rf"config\.json: expected .* found .*{found}"):
        read_json(tmp_path / CONFIG)
