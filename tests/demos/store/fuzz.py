"""Mutants of a dataset's files for the fuzz test.

python -m tests.demos.store.fuzz 20000    counts the outcomes of so many mutants
"""

import io
import json
import sys
import tempfile
import zipfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from magical.demos import Dataset, DatasetWriter, Trajectory
from magical.demos.store import manifest
from magical.demos.store.codec import decode, encode
from magical.demos.store.repair import repair
from magical.errors import DatasetError
from magical.scene import Poses
from magical.tasks import get_task

Mutate = Callable[[bytes, np.random.Generator], bytes]
VALUES: tuple[Any, ...] = (
    None, True, -1, 0, 1.5, 10**400, 1e308, float("nan"), float("inf"), "", "x" * 5000, "\x1b[2J",
    "\ud800", "magical/A-B-v0", "../..", [], {}, [[]], {"a": []}, [1] * 9, "0" * 64,
)  # fmt: skip
NPY_WORDS = (
    b"'descr'", b"|u1", b"<f8", b"|O", b">f8", b"<u9", b"'shape'", b"(", b")", b"False", b"True",
    b"999999999", b"-1", b"((((", b"**", b"{", b"}", b"\\", b"\x00", b"\n",
)  # fmt: skip


def example() -> Trajectory:
    """A short trajectory with poses."""
    scene = get_task("MoveToCorner").demo
    poses = np.stack([Poses.at_rest(scene).bodies] * 4)
    return Trajectory.from_poses("MoveToCorner-Demo-v0", scene, [1, 2, 3], poses, seed=5)


def flip_bits(raw: bytes, rng: np.random.Generator) -> bytes:
    changed = bytearray(raw)
    for _ in range(int(rng.integers(1, 5))):
        changed[int(rng.integers(len(raw)))] ^= 1 << int(rng.integers(8))
    return bytes(changed)


def cut_or_repeat(raw: bytes, rng: np.random.Generator) -> bytes:
    start, end = sorted(rng.integers(len(raw) + 1, size=2).tolist())
    return raw[:end] if rng.random() < 0.5 else raw[:end] + raw[start:]


def overwrite(raw: bytes, rng: np.random.Generator) -> bytes:
    place = int(rng.integers(len(raw)))
    new = bytes(rng.choice([0, 1, 0x7F, 0x80, 0xFF], size=int(rng.integers(1, 9))).tolist())
    return raw[:place] + new + raw[place + len(new) :]


def change_json(text: bytes, rng: np.random.Generator) -> bytes:
    """Replace, remove or nest a random value; sometimes nest so deeply that parsers give up."""
    if rng.random() < 0.05:
        return b'{"env_id":' + b"[" * int(rng.choice([40, 900, 100_000]))
    data = json.loads(text)
    parent: Any = data
    place: Any = str(rng.choice(sorted(data)))
    while isinstance(parent[place], dict | list) and parent[place] and rng.random() < 0.7:
        parent = parent[place]
        keys = sorted(parent) if isinstance(parent, dict) else range(len(parent))
        place = keys[int(rng.integers(len(keys)))]
    action = rng.random()
    if action < 0.15:
        del parent[place]
    elif action < 0.3:
        deep: Any = parent[place]
        for _ in range(int(rng.choice([1, 40, 300]))):
            deep = [deep]
        parent[place] = deep
    else:
        parent[place] = VALUES[int(rng.integers(len(VALUES)))]
    return json.dumps(data).encode()


def change_members(raw: bytes, rng: np.random.Generator) -> bytes:
    """Repack the archive with one member changed, so that all checksums are right."""
    with zipfile.ZipFile(io.BytesIO(raw)) as archive:
        members = {info.filename: archive.read(info) for info in archive.infolist()}
    name = str(rng.choice(sorted(members)))
    action = rng.random()
    if action < 0.4:
        text = members["header.npy"][128:]
        members["header.npy"] = npy(np.frombuffer(change_json(text, rng), np.uint8))
    elif action < 0.5:
        members[name] = npy(np.zeros(tuple(rng.integers(0, 5, size=int(rng.integers(4)))), "<f4"))
    elif action < 0.75:
        start, word = int(rng.integers(8, 120)), NPY_WORDS[int(rng.integers(len(NPY_WORDS)))]
        members[name] = members[name][:start] + word + members[name][start + len(word) :]
    elif action < 0.85:
        members[name] = members[name][:128] + bytes(rng.integers(256, size=3000, dtype=np.uint8))
    else:
        members[str(rng.choice(["poses.npy", "frames_ego.npy", "x", "../x.npy"]))] = members[name]
    file = io.BytesIO()
    method = int(rng.choice([zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2]))
    with zipfile.ZipFile(file, "w", method) as archive:
        for member, content in members.items():
            archive.writestr(member, content)
    return file.getvalue()


def npy(array: Any) -> bytes:
    file = io.BytesIO()
    np.lib.format.write_array(file, np.asarray(array), allow_pickle=False)
    return file.getvalue()


def change_line(raw: bytes, rng: np.random.Generator) -> bytes:
    """Change a value in one line of a manifest, sometimes with right checksums."""
    lines = raw.splitlines(keepends=True)
    place = int(rng.integers(len(lines)))
    changed = change_json(lines[place].strip(), rng)
    if rng.random() < 0.5:
        return b"".join([*lines[:place], changed + b"\n", *lines[place + 1 :]])
    check, text = "", ""
    for line in [*lines[:place], changed, *lines[place + 1 :]]:
        try:
            content = json.loads(line)
            content.pop("check", None)
            signed, check = manifest._line(content, check)
        except (AttributeError, RecursionError, ValueError):
            signed = line.decode(errors="replace") + "\n"
        text += signed
    return text.encode()


TRAJECTORY_MUTATIONS: tuple[Mutate, ...] = (
    flip_bits, cut_or_repeat, overwrite, change_members, change_members, change_members,
)  # fmt: skip
MANIFEST_MUTATIONS: tuple[Mutate, ...] = (
    flip_bits, cut_or_repeat, overwrite, change_line, change_line, change_line,
)  # fmt: skip


def fuzz_trajectories(count: int, seed: int) -> Counter[str]:
    """Decode mutants of a trajectory file; returns how many were decoded or refused.

    Whatever is raised besides `DatasetError` escapes.
    """
    rng, raw, outcomes = np.random.default_rng(seed), encode(example()), Counter[str]()
    for _ in range(count):
        mutant = TRAJECTORY_MUTATIONS[int(rng.integers(len(TRAJECTORY_MUTATIONS)))](raw, rng)
        message = error_of(mutant)
        assert len(message) < 1000, message[:1000]
        assert message.isprintable(), repr(message)
        outcomes["refused" if message else "decoded"] += 1
    return outcomes


def error_of(raw: bytes) -> str:
    """The message with which a file is refused; empty if it is decoded."""
    try:
        decode(raw)
    except DatasetError as error:
        return str(error)
    return ""


def fuzz_manifests(count: int, seed: int, folder: Path) -> Counter[str]:
    """Open datasets whose manifest is a mutant; returns how many were read, refused, repaired."""
    rng, outcomes = np.random.default_rng(seed), Counter[str]()
    writer = DatasetWriter(folder)
    for _ in range(2):
        writer.append(example())
    path = folder / manifest.NAME
    raw = path.read_bytes()
    for _ in range(count):
        path.write_bytes(MANIFEST_MUTATIONS[int(rng.integers(len(MANIFEST_MUTATIONS)))](raw, rng))
        problems = Dataset.open(folder, skip_damaged=True).problems
        assert all(str(problem).isprintable() for problem in problems)
        outcomes["refused" if problems else "read"] += 1
        if rng.random() < 0.1:
            repair(folder)
            assert len(Dataset.open(folder)) == 2
            outcomes["repaired"] += 1
    return outcomes


if __name__ == "__main__":
    number = int(sys.argv[1])
    print("trajectories", dict(fuzz_trajectories(number // 2, seed=0)))
    with tempfile.TemporaryDirectory() as temporary:
        print("manifests", dict(fuzz_manifests(number // 2, 0, Path(temporary) / "fuzzed")))
