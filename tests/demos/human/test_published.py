"""Published files that are damaged, inconsistent, or unpack to too much."""

import gzip
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from magical.demos.human.published import read_demonstration
from magical.errors import MagicalError, UnsafeFileError
from tests.demos.conftest import text


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda p: p.obs.pop(), "expected 3 observations for 2 actions, found 2"),
        (lambda p: p.obs.append(p.obs[0]), "found 4"),
        (lambda p: setattr(p, "acts", b"]"), "acts"),
        (lambda p: setattr(p, "score", b"N"), "score"),
        (lambda p: setattr(p, "score", b"G" + np.array(np.nan, ">f8").tobytes()), "score"),
        (lambda p: setattr(p, "env_name", text("MoveToCornr-Demo-v0")), "not registered"),
        (lambda p: setattr(p, "env_name", text("MoveToCorner-TestAll-v0")), "Demo"),
        (lambda p: setattr(p, "env_name", b"K\x01"), "expected an environment id, found 1"),
        (lambda p: setattr(p, "env_name", text("json:tool-Demo-v0")), "expected an environment id"),
        (lambda p: setattr(p, "after", b"x"), "after the end"),
    ],
)
def test_inconsistent_parts_are_refused(
    tmp_path: Path, published: Any, change: Any, message: str
) -> None:
    made = published()
    change(made)
    file = made.write(tmp_path / "bad.pkl.gz")
    with pytest.raises(MagicalError, match=message) as caught:
        read_demonstration(file)
    assert str(file) in str(caught.value)


@pytest.mark.parametrize(
    ("values", "shape"),
    [
        (np.zeros((384, 384, 3)), None),
        (np.zeros((96, 96, 3), np.uint8), None),
        (np.zeros((384, 384, 3), np.uint8), (384, 384, 4)),
        (np.zeros((384, 384, 3), np.uint8), (-384, -384, 3)),
        (np.zeros((384, 384), np.uint8), None),
        (np.zeros(4, np.uint8), None),
    ],
)
def test_arrays_of_another_shape_or_type_are_refused(
    tmp_path: Path, published: Any, values: Any, shape: Any
) -> None:
    made = published()
    made.obs[0] = made.observation(values, shape)
    with pytest.raises(MagicalError, match=r"bad\.pkl\.gz"):
        read_demonstration(made.write(tmp_path / "bad.pkl.gz"))


def test_more_than_the_largest_size_is_refused(
    tmp_path: Path, published: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("magical.demos.human.safe_pickle.MAX_UNPACKED", 1_000_000)
    file = published().write(tmp_path / "demo.pkl.gz")
    with pytest.raises(UnsafeFileError, match="unpacks to more than 1000000 bytes"):
        read_demonstration(file)


def test_damaged_gzip_file_is_refused_or_read_as_it_was(tmp_path: Path, published: Any) -> None:
    made, rng = published(steps=1), np.random.default_rng(0)
    raw, file = gzip.compress(made.pickle, 1), tmp_path / "bad.pkl.gz"
    for end in (*range(20), len(raw) // 2, len(raw) - 9, len(raw) - 1):
        file.write_bytes(raw[:end])
        with pytest.raises(UnsafeFileError, match=r"bad\.pkl\.gz"):
            read_demonstration(file)
    for place in (*range(12), *rng.integers(len(raw), size=30).tolist(), len(raw) - 3):
        file.write_bytes(raw[:place] + bytes([raw[place] ^ 4]) + raw[place + 1 :])
        try:
            found = str(read_demonstration(file).actions)
        except MagicalError as error:
            found = str(error)
        assert found == str(made.actions) or "bad.pkl.gz" in found


MEASURE = """
import resource, sys, time
from pathlib import Path
from magical.demos.human.published import read_demonstration
from magical.errors import MagicalError
read_demonstration(Path(sys.argv[1]))
before, start = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.process_time()
try:
    read_demonstration(Path(sys.argv[2]))
    print("read")
except MagicalError as error:
    used = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    print(time.process_time() - start, used // 1024, error)
"""
MB = 1 << 20
BOMBS = {  # what comes first, what comes then, and how many megabytes of that
    "zeros": (b"", b"\x00", 10_000),
    "many small lists": (b"\x80\x04", b"]\x94", 400),
    "nested lists": (b"\x80\x04", b"](", 400),
    "large strings": (b"\x80\x04", b"B" + np.uint32(MB - 5).tobytes() + b"x" * (MB - 5), 400),
    "bytes of no array": (
        b"\x80\x04",
        b"B" + np.uint32(MB // 2 - 5).tobytes() + b"x" * (MB // 2 - 5),
        400,
    ),
    "one large string": (b"\x80\x04\x8e" + (400 * MB).to_bytes(8, "little"), b"x", 400),
    "a large line": (b"c", b"x", 400),
}


@pytest.mark.linux
@pytest.mark.parametrize("name", BOMBS)
def test_bomb_is_refused_quickly_in_little_memory(
    tmp_path: Path, published: Any, name: str
) -> None:
    good, bomb = published().write(tmp_path / "good.pkl.gz"), tmp_path / "bomb.pkl.gz"
    first, then, megabytes = BOMBS[name]
    member = gzip.compress(then * (10 * MB // len(then)), 1)
    bomb.write_bytes(gzip.compress(first) + member * (megabytes // 10))
    done = subprocess.run(
        [sys.executable, "-c", MEASURE, good, bomb], capture_output=True, text=True, check=True
    )
    seconds, used, message = done.stdout.split(maxsplit=2)
    assert "bomb.pkl.gz" in message
    assert float(seconds) <= 2.0
    assert int(used) <= 200  # megabytes
