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
from magical.envs import parse_env_id
from magical.errors import DatasetError
from magical.scene import Poses

ESCAPES = "\x1b[2J\x07"
MB = 1 << 20


@pytest.fixture(scope="module")
def raw(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A file's bytes."""
    folder = tmp_path_factory.mktemp("dataset")
    env_id = parse_env_id("MatchRegions-TestAll-v0")
    scene, dynamics = env_id.task_spec.sample(env_id.variant, np.random.default_rng(0))
    bodies = np.zeros((4, 5 + len(scene.blocks), 6))
    bodies[..., :3] = Poses.at_rest(scene).bodies
    made = Trajectory.from_bodies(env_id, scene, [1, 2, 3], bodies, dynamics=dynamics)
    return (folder / DatasetWriter(folder).append(made).file).read_bytes()


def members(raw: bytes) -> dict[str, bytes]:
    with zipfile.ZipFile(io.BytesIO(raw)) as archive:
        return {info.filename: archive.read(info) for info in archive.infolist()}


def packed(contents: dict[str, bytes], method: int = zipfile.ZIP_DEFLATED) -> bytes:
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


def with_header(raw: bytes, **changes: Any) -> bytes:
    contents = members(raw)
    text = json.loads(np.load(io.BytesIO(contents["header.npy"])).tobytes())
    for name, value in changes.items():
        text[name] = value
    contents["header.npy"] = npy(np.frombuffer(json.dumps(text).encode(), np.uint8))
    return packed(contents)


def read(folder: Path, content: bytes) -> Trajectory:
    (folder / "x.npz").write_bytes(content)
    return Dataset.open(folder)[0]


BAD: dict[str, Callable[[bytes], bytes]] = {
    "another file": lambda _: b"hello",
    "cut off": lambda raw: raw[:-30],
    "no actions": lambda raw: packed({"header.npy": members(raw)["header.npy"]}),
    "an object array": lambda raw: packed(
        members(raw) | {"actions.npy": npy(np.array([{}, 1], object))}
    ),
    "many actions": lambda raw: packed(
        members(raw) | {"actions.npy": npy(np.zeros(3 << 20, np.uint8))}
    ),
    "a huge shape": lambda raw: packed(
        members(raw) | {"bodies.npy": declared("(10**9, 9)", "<f8")}
    ),
    "a huge shape as a number": lambda raw: packed(
        members(raw) | {"actions.npy": declared("(999999999999,)")}
    ),
    "huge items": lambda raw: packed(
        members(raw) | {"actions.npy": declared("(3,)", "|S999999999")}
    ),
    "a scalar": lambda raw: packed(members(raw) | {"actions.npy": declared("()", data=b"x")}),
    "many members": lambda raw: packed(members(raw) | {f"{i}.npy": b"" for i in range(99)}),
    "slow compression": lambda raw: packed(members(raw), zipfile.ZIP_LZMA),
    "an unknown field": lambda raw: with_header(raw, more=1),
    "another format": lambda raw: with_header(raw, format="other"),
    "a newer version": lambda raw: with_header(raw, version=3),
    "a module's name": lambda raw: with_header(raw, env_id="json.tool:x-Demo-v0"),
    "an unknown task": lambda raw: with_header(raw, env_id=f"magical/{'x' * 150}-Demo-v0"),
    "a score of 2": lambda raw: with_header(raw, score=2),
    "a large seed": lambda raw: with_header(raw, seed=10**400),
    "deep metadata": lambda raw: with_header(raw, metadata={"a": json.loads("[" * 40 + "]" * 40)}),
    "another scene": lambda raw: with_header(raw, scene={"robot": [5, 5, 0]}),
    "escapes": lambda raw: with_header(raw, dynamics={ESCAPES: 1.0}),
}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_file_is_refused_in_one_line_that_names_it(
    tmp_path: Path, raw: bytes, name: str
) -> None:
    content = BAD[name](raw)
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


def test_what_unpacks_to_too_much_is_not_unpacked(tmp_path: Path, raw: bytes) -> None:
    bomb = packed(members(raw) | {"bodies.npy": declared(f"({600 * MB},)", data=bytes(600 * MB))})
    lie = bomb.replace((600 * MB + 128).to_bytes(4, "little"), (131).to_bytes(4, "little"))
    assert len(bomb) < 2 * MB
    for content in (bomb, lie):
        tracemalloc.start()
        with pytest.raises(DatasetError):
            read(tmp_path, content)
        assert tracemalloc.get_traced_memory()[1] < 16 * MB
        tracemalloc.stop()


def mutated(contents: dict[str, bytes], data: st.DataObject) -> bytes:
    """The members with some bytes of one replaced, in an archive whose checksums are right."""
    name = data.draw(st.sampled_from(sorted(contents)))
    old = contents[name]
    place = data.draw(st.integers(0, len(old)))
    new = data.draw(
        st.binary(max_size=8) | st.sampled_from([b"1e308", b"-1", b"null", b"[[", b"9" * 9])
    )
    return packed({**contents, name: old[:place] + new + old[place + len(new) :]})


@settings(max_examples=200, deadline=None)
@given(data=st.data())
def test_any_change_is_refused_or_gives_a_trajectory_that_can_be_used(
    raw: bytes, tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    place = data.draw(st.integers(0, len(raw)))
    whole = (
        raw[:place] + data.draw(st.binary(max_size=4)) + raw[data.draw(st.integers(0, len(raw))) :]
    )
    content = mutated(members(raw), data) if data.draw(st.booleans()) else whole
    try:
        trajectory = read(tmp_path_factory.mktemp("mutant"), content)
    except DatasetError:
        return
    Frames(trajectory, "ego").take([0, len(trajectory)])
    replay(trajectory)
