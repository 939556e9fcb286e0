"""Datasets made to do harm: every file is refused by name, the rest stays usable."""

import io
import json
import os
import tracemalloc
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from magical.cli import main
from magical.demos import Dataset, DatasetWriter
from magical.demos.store import manifest
from magical.demos.store.codec import MAX_HEADER, decode, encode
from magical.demos.store.repair import repair
from magical.errors import DatasetError, TrajectoryError
from magical.files import LOCK
from tests.demos.conftest import MakeTrajectory

ESCAPES = "\x1b[2J\x07\r\u202e"


def with_members(raw: bytes, method: int = zipfile.ZIP_DEFLATED, /, **changed: bytes) -> bytes:
    """The archive with members replaced; all checksums are right."""
    with zipfile.ZipFile(io.BytesIO(raw)) as archive:
        members = {info.filename: archive.read(info) for info in archive.infolist()}
    members |= {f"{name}.npy": content for name, content in changed.items()}
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", method) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return file.getvalue()


def npy(header: str, data: bytes = b"") -> bytes:
    text = header.encode().ljust(118) if len(header) < 118 else header.encode()
    return b"\x93NUMPY\x01\x00" + (len(text) + 1).to_bytes(2, "little") + text + b"\n" + data


def array(shape: str, dtype: str = "|u1", data: bytes = b"") -> bytes:
    return npy(f"{{'descr': '{dtype}', 'fortran_order': False, 'shape': {shape}, }}", data)


def with_header(raw: bytes, change: bytes | dict[str, Any]) -> bytes:
    if isinstance(change, dict):
        with zipfile.ZipFile(io.BytesIO(raw)) as archive:
            text = archive.read("header.npy")[128:]
        change = json.dumps({**json.loads(text), **change}).encode()
    return with_members(raw, header=array(f"({len(change)},)", data=change))


@contextmanager
def bounded_memory(limit: int) -> Iterator[None]:
    """Fail if more than `limit` bytes are allocated at one time."""
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] < limit
    finally:
        tracemalloc.stop()


DEEP: list[Any] = []
for _ in range(500):
    DEEP = [DEEP]

HEADERS: dict[str, bytes | dict[str, Any]] = {  # the text, or fields that are changed in it
    "JSON nested too deeply to parse": b'{"metadata":' + b"[" * 100_000,
    "JSON nested too deeply to compare": {"metadata": {"a": DEEP}},
    "JSON that is no object": b"[1]",
    "JSON that is not UTF-8": b"\xff\xfe{",
    "no fields": b"{}",
    "a number of 4000 digits": {"seed": 10**4000},
    "a score of 4000 digits": {"score": 10**4000},
    "a seed of text": {"seed": "x" * 10_000},
    "an environment id of a list": {"env_id": ["magical"]},
    "an environment id of 100,000 characters": {"env_id": "x" * 100_000},
    "a scene of text": {"scene": ESCAPES * 1000},
    "a scene with an infinite position": {"scene": {"robot": [10**400, 0, 0]}},
    "a robot of text": {"scene": {"robot": "abc"}},
    "dynamics of a number": {"dynamics": 3},
    "metadata of a list": {"metadata": [1]},
}
MEMBERS: dict[str, dict[str, bytes]] = {
    "a shape of a terabyte": {"actions": array("(999999999999,)")},
    "labels of another length": {"expert_actions": array("(3,)", data=b"\x00" * 3)},
    "labels of a terabyte": {"expert_actions": array("(999999999999,)")},
    "a negative shape": {"actions": array("(-1,)")},
    "no shape": {"actions": array("()", data=b"\x00")},
    "an .npy header that is no literal": {"poses": npy("{'descr': (((")},
    "an .npy header of nested brackets": {"poses": npy("(" * 9000)},
    "an .npy header that is empty": {"poses": b"\x93NUMPY\x01\x00"},
    "objects": {"actions": array("(3,)", "|O", b"\x80\x04N.")},
}
DAMAGE: dict[str, Callable[[bytes], bytes]] = {
    **{name: partial(with_header, change=change) for name, change in HEADERS.items()},
    **{name: partial(with_members, **changed) for name, changed in MEMBERS.items()},
    "another compression": lambda raw: with_members(raw, zipfile.ZIP_BZIP2),
    "a member with another name": lambda raw: raw.replace(b"poses.npy", b"\x1b[2J\r.npy"),
    "no archive": lambda _: b"\x00" * 100,
    "nothing": lambda _: b"",
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_damage_of_one_file_is_reported_and_repaired(
    small_dataset: Path, damage: str, capsys: pytest.CaptureFixture[str]
) -> None:
    entry = Dataset.open(small_dataset).entries[1]
    file = small_dataset / entry.file
    raw = DAMAGE[damage](file.read_bytes())
    with pytest.raises(DatasetError) as caught:
        decode(raw)
    assert len(str(caught.value)) < 500
    assert str(caught.value).isprintable()
    file.write_bytes(raw)
    assert main(["demos", "info", str(small_dataset)]) == 1
    assert str(file) in capsys.readouterr().err
    assert main(["demos", "info", str(small_dataset), "--repair"]) == 0
    assert [t.seed for t in Dataset.open(small_dataset)] == [1, 3]
    assert (small_dataset / "damaged" / file.name).read_bytes() == raw


@pytest.mark.parametrize("name", ["evil:X", "evil.py:X", "./evil.py:X"])
def test_no_module_that_a_file_names_is_imported(
    tmp_path: Path, make_trajectory: MakeTrajectory, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    Path("evil.py").write_text("open('executed', 'w').close()")
    with pytest.raises(DatasetError, match="expected an environment id"):
        decode(with_header(encode(make_trajectory()), {"env_id": f"magical/{name}-Demo-v0"}))
    assert not Path("executed").exists()


def make_fifo(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


def link_outside(path: Path) -> None:
    outside = path.parents[2] / "outside"
    path.rename(outside)
    path.symlink_to(outside)


def make_huge(path: Path) -> None:
    os.truncate(path, 20 << 30)


SPECIAL_FILES = [make_fifo, link_outside, make_huge]


@pytest.mark.posix
@pytest.mark.parametrize("replace", SPECIAL_FILES)
def test_special_file_instead_of_a_trajectory(
    small_dataset: Path, replace: Callable[[Path], None]
) -> None:
    file = small_dataset / Dataset.open(small_dataset).entries[1].file
    replace(file)
    with bounded_memory(20 << 20):
        dataset = Dataset.open(small_dataset, skip_damaged=True)
        with pytest.raises(DatasetError, match=file.name):
            list(Dataset.open(small_dataset))
        assert [t.seed for t in dataset] == [1, 3]
        assert [problem.file for problem in dataset.problems] == [str(file)]
        assert [problem.file for problem in repair(small_dataset)] == [str(file)]
    assert [t.seed for t in Dataset.open(small_dataset)] == [1, 3]


@pytest.mark.posix
@pytest.mark.parametrize("name", [manifest.NAME, LOCK])
@pytest.mark.parametrize("replace", SPECIAL_FILES[:2])
def test_special_file_instead_of_the_manifest_or_lock(
    small_dataset: Path, make_trajectory: MakeTrajectory, name: str, replace: Any
) -> None:
    trajectory = make_trajectory()
    replace(small_dataset / name)
    with pytest.raises(DatasetError, match=name):
        Dataset.open(small_dataset)
    with pytest.raises(DatasetError, match=name):
        DatasetWriter(small_dataset).append(trajectory)


def test_trajectories_outside_the_dataset_are_not_read(small_dataset: Path) -> None:
    stored, outside = small_dataset / manifest.FOLDER, small_dataset.parent / "outside"
    stored.rename(outside)
    stored.symlink_to(outside)
    with pytest.raises(DatasetError, match="found a symbolic link"):
        Dataset.open(small_dataset)
    with pytest.raises(DatasetError, match="found a symbolic link"):
        repair(small_dataset)


def test_manifest_of_damaged_lines_is_not_read_to_its_end(small_dataset: Path) -> None:
    with (small_dataset / manifest.NAME).open("ab") as file:
        file.write(b"\n" * 5_000_000)
    problems = Dataset.open(small_dataset, skip_damaged=True).problems
    assert len(problems) == manifest.MAX_DAMAGED_LINES + 1
    assert "more than 1000 damaged lines" in str(problems[-1])


@pytest.mark.parametrize(
    "change",
    [
        {"size": 10**30},
        {"length": -1},
        {"index": "0"},
        {"sha256": "0" * 63},
        {"score": [0.5]},
        {"demonstrator": {"a": 1}},
        {"demonstrator": "x" * 100_000},
        {"source": ["a"]},
        {"has_poses": 1},
        {"fingerprint": None},
        {"file": "../../secret.npz"},
        {"env_id": "magical/../../x-Demo-v0"},
        {"env_id": f"magical/{ESCAPES}-Demo-v0"},
    ],
)
def test_entry_of_wrong_types_and_sizes_is_refused(
    small_dataset: Path, change: dict[str, Any]
) -> None:
    file = small_dataset / manifest.NAME
    header, first, *_ = file.read_text().splitlines(keepends=True)
    content = {**json.loads(first), **change}
    del content["check"]
    line, _ = manifest._line(content, json.loads(header)["check"])
    file.write_text(header + line)
    problems = Dataset.open(small_dataset, skip_damaged=True).problems
    assert "line 2 or the line before it is damaged" in str(problems[0])


def test_source_of_another_type_is_not_taken_for_a_file(
    tmp_path: Path, make_trajectory: MakeTrajectory
) -> None:
    entry = DatasetWriter(tmp_path / "d").append(make_trajectory(metadata={"source": [1]}))
    assert entry.source is None
    assert len(Dataset.open(tmp_path / "d", skip_damaged=True)) == 1


def test_metadata_that_could_not_be_read_again_is_refused(make_trajectory: MakeTrajectory) -> None:
    with pytest.raises(TrajectoryError, match="metadata: expected at most"):
        encode(make_trajectory(metadata={"note": "x" * MAX_HEADER}))
    with pytest.raises(TrajectoryError, match="levels deep"):
        make_trajectory(metadata={"a": DEEP})


@pytest.mark.parametrize("command", ["info", "replay", "video --out {}/v.webp", "info --repair"])
def test_terminal_escapes_are_shown_escaped(
    tmp_path: Path,
    make_trajectory: MakeTrajectory,
    capsys: pytest.CaptureFixture[str],
    command: str,
) -> None:
    path = tmp_path / "dataset"
    writer = DatasetWriter(path)
    for _ in range(2):
        writer.append(make_trajectory(demonstrator=f"me{ESCAPES}", metadata={"source": ESCAPES}))
    (path / manifest.FOLDER / f"{ESCAPES}.npz").write_bytes(b"")
    name, *rest = command.format(tmp_path).split()
    main(["demos", name, str(path), *rest])
    shown = capsys.readouterr()
    assert all(line.isprintable() for line in (shown.out + shown.err).split("\n"))


def test_huge_deflated_member_is_not_unpacked(make_trajectory: MakeTrajectory) -> None:
    raw = encode(make_trajectory())
    bomb = with_members(raw, actions=array("(40000000,)", data=b"\x00" * 40_000_000))
    with zipfile.ZipFile(io.BytesIO(bomb)) as archive:
        size = archive.getinfo("actions.npy").file_size
    lie = bomb.replace(size.to_bytes(4, "little"), (131).to_bytes(4, "little"))
    for raw in (bomb, lie):
        with bounded_memory(5 << 20), pytest.raises(DatasetError):
            decode(raw)


def test_frames_of_another_length_are_refused_before_they_are_read() -> None:
    shape = np.zeros((3, 96, 96, 3), np.uint8)
    file = io.BytesIO()
    np.savez_compressed(
        file, header=np.frombuffer(b"{}", np.uint8), actions=np.zeros(9, np.uint8), frames_ego=shape
    )
    with pytest.raises(DatasetError, match=r"frames_ego: expected \|u1 of shape \(10, 96, 96, 3\)"):
        decode(file.getvalue())
