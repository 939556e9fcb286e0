"""Mutants of a dataset's files for the fuzz test.

python -m tests.demos.store.fuzz 20000    counts the outcomes of so many mutants

Whatever is accepted is used: rendered, replayed, scored and observed. With `NUMBA_BOUNDSCHECK=1`
the compiled code checks every index.
"""

import io
import json
import sys
import tempfile
import time
import zipfile
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from magical.demos import Dataset, DatasetWriter, Frames, Trajectory, observations
from magical.demos.replay import replay
from magical.demos.store import manifest
from magical.demos.store.codec import decode, encode
from magical.demos.store.repair import repair
from magical.envs import parse_env_id
from magical.errors import DatasetError, InvalidSceneError, TrajectoryError
from magical.scene import Poses

Mutate = Callable[[bytes, np.random.Generator], bytes]
VALUES: tuple[Any, ...] = (
    None, True, -1, 0, 1.5, 10**400, float("nan"), float("inf"), "", "x" * 5000, "\x1b[2J",
    "\ud800", "magical/A-B-v0", "../..", [], {}, [[]], {"a": []}, [1] * 9, "0" * 64, "star",
    "red", 2**70,
)  # fmt: skip
EXTREMES = (1e308, -1e308, 1e154, 1e18, 1e6, 11.0, 1.05, -0.5, 0.0, -0.0, 5e-324)
NPY_WORDS = (
    b"'descr'", b"|u1", b"<f8", b"|O", b">f8", b"<u9", b"'shape'", b"(", b")", b"False", b"True",
    b"999999999", b"-1", b"((((", b"**", b"{", b"}", b"\\", b"\x00", b"\n",
)  # fmt: skip
ENV_IDS = ("MoveToCorner-Demo-v0", "MatchRegions-TestAll-v0", "ClusterShape-TestShape-v0")
SLOW = 5.0  # s, for what is done with one mutant


def example(env_id: str = ENV_IDS[0]) -> Trajectory:
    """A short trajectory with poses."""
    parsed, rng = parse_env_id(env_id), np.random.default_rng(0)
    scene, dynamics = parsed.task_spec.sample(parsed.variant, rng)
    poses = np.stack([Poses.at_rest(scene).bodies] * 4)
    return Trajectory.from_poses(env_id, scene, [1, 2, 3], poses, seed=5, dynamics=dynamics)


def use(trajectory: Trajectory) -> None:
    """Do what the package does with a stored trajectory; only its own errors may be raised."""
    Frames(trajectory, "ego").take([0, len(trajectory)])
    Frames(trajectory, "allo", 32).take([len(trajectory)])
    replay(trajectory)
    for poses in [] if trajectory.poses is None else trajectory.poses:
        for score in (trajectory.task.score, trajectory.task.published_code_score):
            assert 0.0 <= score(trajectory.scene, Poses(poses)) <= 1.0
    with suppress(TrajectoryError, InvalidSceneError):  # not the simulation's, or beyond it
        observations(trajectory, "state")


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
    """Replace, remove or nest a random value; sometimes nest so deeply that parsers give up.

    In the header of a trajectory mostly the scene and the dynamics.
    """
    if rng.random() < 0.03:
        return b'{"env_id":' + b"[" * int(rng.choice([40, 900, 100_000]))
    data = json.loads(text)
    parent: Any = data
    place: Any = str(
        rng.choice([name for name in ("scene", "dynamics") if name in data] * 5 + [*data])
    )
    while isinstance(parent[place], dict | list) and parent[place] and rng.random() < 0.9:
        parent = parent[place]
        keys = sorted(parent) if isinstance(parent, dict) else range(len(parent))
        place = keys[int(rng.integers(len(keys)))]
    action = rng.random()
    if action < 0.05:
        del parent[place]
    elif action < 0.1:
        for _ in range(int(rng.choice([1, 40, 300]))):
            parent[place] = [parent[place]]
    elif action < 0.2 and isinstance(parent, list):  # more blocks or regions, or none
        parent[:] = parent * int(rng.choice([0, 2, 30, 3000]))
    else:
        values = EXTREMES if isinstance(parent[place], float) and rng.random() < 0.8 else VALUES
        parent[place] = values[int(rng.integers(len(values)))]
    return json.dumps(data).encode()


def change_members(raw: bytes, rng: np.random.Generator) -> bytes:
    """Repack the archive with one member changed, so that all checksums are right."""
    with zipfile.ZipFile(io.BytesIO(raw)) as archive:
        members = {info.filename: archive.read(info) for info in archive.infolist()}
    name = str(rng.choice(sorted(members)))
    action = rng.random()
    if action < 0.3:
        text = change_json(members["header.npy"][128:], rng)
        members["header.npy"] = npy(np.frombuffer(text, np.uint8))
    elif action < 0.4:
        poses = members["poses.npy"]
        place, value = 128 + 8 * int(rng.integers((len(poses) - 128) // 8)), rng.choice(EXTREMES)
        members["poses.npy"] = poses[:place] + np.float64(value).tobytes() + poses[place + 8 :]
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
    """Decode and use mutants of trajectory files.

    Returns:
        How many were refused, accepted as they were, accepted and different.

    Raises:
        AssertionError: a refusal's message is long or cannot be printed; a mutant took too long.
        Exception: what escaped besides `DatasetError`.
    """
    rng, outcomes = np.random.default_rng(seed), Counter[str]()
    files = [encode(example(env_id)) for env_id in ENV_IDS]
    use(decode(files[0]))  # compiles, which takes longer than a mutant may
    for number in range(count):
        raw = files[number % len(files)]
        mutant = TRAJECTORY_MUTATIONS[int(rng.integers(len(TRAJECTORY_MUTATIONS)))](raw, rng)
        start = time.process_time()
        try:
            trajectory = decode(mutant)
        except DatasetError as error:
            message = str(error)
            assert len(message) < 1000, message[:1000]
            assert message.isprintable(), repr(message)
            outcomes["refused"] += 1
        else:
            use(trajectory)
            same = encode(trajectory) == raw
            outcomes["accepted and equal" if same else "accepted, another trajectory"] += 1
        assert time.process_time() < start + SLOW, f"mutant {number} of seed {seed}"
    return outcomes


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
