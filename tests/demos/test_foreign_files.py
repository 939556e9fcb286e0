"""A trajectory's file of others is read, or refused in one line and little memory."""

import io
import json
import tracemalloc
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from magical.demos import Dataset, DatasetWriter, Frames, Trajectory
from magical.demos.trajectory import replay
from magical.errors import DatasetError
from tests.demos.conftest import make_trajectory

MB = 1 << 20
Contents = dict[str, bytes]  # of an archive, by name


@pytest.fixture(scope="module")
def contents(tmp_path_factory: pytest.TempPathFactory) -> Contents:
    folder = tmp_path_factory.mktemp("dataset")
    made = make_trajectory("MatchRegions-TestAll-v0", steps=3)
    with zipfile.ZipFile(folder / DatasetWriter(folder).append(made).file) as archive:
        return {info.filename: archive.read(info) for info in archive.infolist()}


def packed(contents: Contents, method: int = zipfile.ZIP_DEFLATED) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", method) as archive:
        for name, content in contents.items():
            archive.writestr(name, content)
    return file.getvalue()


def npy(array: Any) -> bytes:
    file = io.BytesIO()
    np.lib.format.write_array(file, np.asarray(array))
    return file.getvalue()


def declared(shape: str, dtype: str = "|u1", data: bytes = b"") -> bytes:
    """An array whose header declares something else than its data."""
    text = f"{{'descr': '{dtype}', 'fortran_order': False, 'shape': {shape}, }}".ljust(117) + "\n"
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text.encode() + data


def header(**changes: Any) -> Callable[[Contents], bytes]:
    def changed(contents: Contents) -> bytes:
        text = json.loads(np.load(io.BytesIO(contents["header.npy"])).tobytes()) | changes
        new = npy(np.frombuffer(json.dumps(text).encode(), np.uint8))
        return packed(contents | {"header.npy": new})

    return changed


def array(name: str, content: bytes) -> Callable[[Contents], bytes]:
    return lambda contents: packed(contents | {f"{name}.npy": content})


def read(folder: Path, content: bytes) -> Trajectory:
    (folder / "x.npz").write_bytes(content)
    return Dataset.open(folder)[0]


BAD: dict[str, Callable[[Contents], bytes]] = {
    "another file": lambda _: b"hello",
    "cut off": lambda contents: packed(contents)[:-30],
    "no actions": lambda contents: packed({"header.npy": contents["header.npy"]}),
    "an object array": array("actions", npy(np.array([{}, 1], object))),
    "many actions": array("actions", npy(np.zeros(3 << 20, np.uint8))),
    "a huge shape": array("bodies", declared("(10**9, 9)", "<f8")),
    "huge items": array("actions", declared("(3,)", "|S999999999")),
    "many members": lambda contents: packed(contents | {f"{i}.npy": b"" for i in range(99)}),
    "slow compression": lambda contents: packed(contents, zipfile.ZIP_LZMA),
    "an unknown field": header(more=1),
    "a newer version": header(version=3),
    "a module's name": header(env_id="json.tool:x-Demo-v0"),
    "an unknown task": header(env_id=f"magical/{'x' * 150}-Demo-v0"),
    "a score of 2": header(score=2),
    "another scene": header(scene={"robot": [5, 5, 0]}),
    "escapes": header(dynamics={"\x1b[2J\x07": 1.0}),
}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_file_is_refused_in_one_line_that_names_it(
    tmp_path: Path, contents: Contents, name: str
) -> None:
    content = BAD[name](contents)
    tracemalloc.start()
    with pytest.raises(DatasetError) as caught:
        read(tmp_path, content)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    message = str(caught.value)
    assert message.startswith(str(tmp_path / "x.npz"))
    assert message.isprintable()
    assert len(message) < 1500
    assert peak < 16 * MB


def test_what_unpacks_to_too_much_is_not_unpacked(
    tmp_path: Path, contents: Contents, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("magical.demos.dataset.MAX_UNPACKED", 16 * MB)
    bomb = array("bodies", declared(f"({20 * MB},)", data=bytes(20 * MB)))(contents)
    lie = bomb.replace((20 * MB + 128).to_bytes(4, "little"), (131).to_bytes(4, "little"))
    for content in (bomb, lie):
        tracemalloc.start()
        with pytest.raises(DatasetError):
            read(tmp_path, content)
        assert tracemalloc.get_traced_memory()[1] < 4 * MB
        tracemalloc.stop()


@settings(max_examples=100, deadline=None)
@given(data=st.data())
def test_any_change_is_refused_or_gives_a_trajectory_that_can_be_used(
    contents: Contents, tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    """Bytes of the file are replaced, or of a member of an archive whose checksums are right."""
    name = data.draw(st.sampled_from(["", *sorted(contents)]))
    old = contents[name] if name else packed(contents)
    place = data.draw(st.integers(0, len(old)))
    interesting = st.sampled_from([b"1e308", b"-1", b"null", b"[[", b"9" * 9])
    new = data.draw(st.binary(max_size=8) | interesting)
    after = data.draw(st.integers(0, len(old))) if not name else place + len(new)
    content = old[:place] + new + old[after:]
    try:
        trajectory = read(
            tmp_path_factory.mktemp("mutant"),
            packed({**contents, name: content}) if name else content,
        )
    except DatasetError:
        return
    Frames(trajectory, "ego").take([0, len(trajectory)])
    replay(trajectory)
