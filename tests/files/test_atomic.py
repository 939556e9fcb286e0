"""Writing in one go."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from magical.files import remove_partial_files, write_atomically


def test_a_file_appears_whole_in_a_new_folder(tmp_path: Path) -> None:
    path = tmp_path / "a" / "b.bin"
    with write_atomically(path) as file:
        file.write(b"half")
        assert not path.exists()
        file.write(b"whole")
    assert path.read_bytes() == b"halfwhole"
    assert list(path.parent.iterdir()) == [path]


def test_a_failure_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "x.bin"
    path.write_bytes(b"old")

    def fail() -> None:
        with write_atomically(path) as file:
            file.write(b"new")
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_the_file_has_the_usual_permissions(tmp_path: Path) -> None:
    (tmp_path / "plain").touch()
    with write_atomically(tmp_path / "careful"):
        pass
    assert (tmp_path / "careful").stat().st_mode == (tmp_path / "plain").stat().st_mode


KILLED = """
import os, signal, sys
from magical.files import remove_partial_files, write_atomically
with write_atomically(sys.argv[1]) as file:
    file.write(b"half")
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_what_a_killed_process_left_is_removed(tmp_path: Path) -> None:
    for name in ("a.json", "b.json"):
        subprocess.run([sys.executable, "-c", KILLED, str(tmp_path / name)])
    for kept in (".a.json.part", "a.json.1.part", ".a.json.x.part", ".a.json.1.part.json"):
        (tmp_path / kept).touch()
    (tmp_path / ".a.json.1.part").mkdir()
    before = set(tmp_path.iterdir())
    remove_partial_files(tmp_path, "a.*", "c.json")
    (removed,) = before - set(tmp_path.iterdir())
    assert re.fullmatch(r"\.a\.json\.\d+\.part", removed.name)


def test_partial_files_behind_a_symbolic_link_are_kept(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    (tmp_path / "link").symlink_to("real")
    (tmp_path / "real" / ".a.1.part").touch()
    remove_partial_files(tmp_path / "link", "a")
    remove_partial_files(tmp_path / "missing", "a")
    assert list((tmp_path / "real").iterdir())
