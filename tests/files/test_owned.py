"""Folders that one process at a time owns."""

import errno
import os
from pathlib import Path

import pytest

from magical.errors import RunFolderError
from magical.files import LOCK, OwnedFolder


def owned(path: Path) -> OwnedFolder:
    return OwnedFolder(path, ("first.json", "*.npz"), RunFolderError, "trains this", "go on")


def create(path: Path) -> None:
    with owned(path).locked():
        (path / "first.json").touch()


def test_a_new_and_an_empty_folder_are_created(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    for path in (tmp_path / "a" / "new", tmp_path / "empty"):
        assert not owned(path).exists()
        create(path)
        assert owned(path).exists()
        create(path)


def test_the_lock_is_refused_to_another(tmp_path: Path) -> None:
    with owned(tmp_path / "x").locked():
        message = rf"x: process {os.getpid()} already trains this; wait for it to end, or stop it"
        with pytest.raises(RunFolderError, match=message):
            create(tmp_path / "x")
    create(tmp_path / "x")


def test_what_killed_owners_left_is_removed(tmp_path: Path) -> None:
    left = {".first.json.1234abcd.part", ".a.npz.77.part"}
    kept = {".b.txt.1234abcd.part", "first.json"}
    for name in left | kept:
        (tmp_path / name).touch()
    create(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == kept | {LOCK}


def test_a_folder_whose_creation_was_killed_is_new(tmp_path: Path) -> None:
    (tmp_path / LOCK).touch()
    (tmp_path / ".first.json.1234abcd.part").touch()
    create(tmp_path)


def test_other_things_are_left_alone(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "folder").mkdir()
    (tmp_path / "link").symlink_to("folder")
    (tmp_path / "dangling").symlink_to("nowhere")
    for path in (tmp_path, tmp_path / "file", tmp_path / "link", tmp_path / "dangling"):
        with pytest.raises(RunFolderError, match=r"expected a .*folder, found"):
            create(path)
    assert not list((tmp_path / "folder").iterdir())
    create(tmp_path / "folder")
    with pytest.raises(RunFolderError, match="found a symbolic link; give the folder itself"):
        create(tmp_path / "link")


@pytest.mark.parametrize("name", ["ENOSPC", "EDQUOT"])
def test_a_full_disk_is_one_error(tmp_path: Path, name: str) -> None:
    full = pytest.raises(RunFolderError, match=r"no space left on the device.* then go on")
    with full, owned(tmp_path).locked():
        raise OSError(getattr(errno, name), "full")
    with pytest.raises(PermissionError), owned(tmp_path).locked():
        raise PermissionError
