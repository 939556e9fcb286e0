"""Mutants of a checkpoint for the fuzz test.

python -m tests.learning.running.fuzz_checkpoints 20000    counts the outcomes of so many mutants
"""

import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch

from magical.errors import CheckpointError
from magical.learning.running.checkpoints import load_checkpoint, save_checkpoint

Mutate = Callable[[bytes, np.random.Generator], bytes]
HEADER_WORDS = (
    b"F32", b"F64", b"I64", b"shape", b"[", b"]", b"{", b"}", b",", b" ", b"0", b"9", b"-1",
    b"__metadata__", b"sha256", b"NaN", b"null", b"\x00",
)  # fmt: skip


def flip_bits(raw: bytes, rng: np.random.Generator) -> bytes:
    changed = bytearray(raw)
    for _ in range(int(rng.integers(1, 5))):
        changed[int(rng.integers(len(raw)))] ^= 1 << int(rng.integers(8))
    return bytes(changed)


def truncate(raw: bytes, rng: np.random.Generator) -> bytes:
    return raw[: int(rng.integers(len(raw)))]


def append(raw: bytes, rng: np.random.Generator) -> bytes:
    return raw + rng.bytes(int(rng.integers(1, 100)))


def swap(raw: bytes, rng: np.random.Generator) -> bytes:
    """Exchange two ranges of the same length."""
    length = int(rng.integers(1, len(raw) // 4))
    first, second = sorted(rng.integers(len(raw) - length, size=2).tolist())
    second = max(second, first + length)
    return (
        raw[:first]
        + raw[second : second + length]
        + raw[first + length : second]
        + raw[first : first + length]
        + raw[second + length :]
    )


def edit_header(raw: bytes, rng: np.random.Generator) -> bytes:
    """Overwrite or insert a word in the length or the JSON of the header."""
    end = 8 + int.from_bytes(raw[:8], "little")
    place = int(rng.integers(end))
    word = HEADER_WORDS[int(rng.integers(len(HEADER_WORDS)))]
    rest = place + len(word) if rng.random() < 0.5 else place
    return raw[:place] + word + raw[rest:]


def zero(raw: bytes, rng: np.random.Generator) -> bytes:
    """A range of zeros, as after the loss of a disk's block."""
    start, end = sorted(rng.integers(len(raw) + 1, size=2).tolist())
    return raw[:start] + bytes(end - start) + raw[end:]


def empty(raw: bytes, rng: np.random.Generator) -> bytes:
    return b""


MUTATIONS: tuple[Mutate, ...] = (
    flip_bits, flip_bits, truncate, append, swap, edit_header, edit_header, zero, empty,
)  # fmt: skip


def write_example(path: Path) -> None:
    """A small checkpoint: weights, the state of an optimiser, and plain values."""
    generator = torch.Generator().manual_seed(0)
    state = {
        "policy": {"weight": torch.rand(4, 3, generator=generator), "bias": torch.zeros(4)},
        "optimizer": {"state": {"0": {"step": torch.tensor(5)}}, "param_groups": [{"lr": 1e-3}]},
        "step": 5,
    }
    save_checkpoint(path, state)


def fuzz_checkpoints(count: int, seed: int, folder: Path) -> Counter[str]:
    """Load mutants of a checkpoint; returns how many were refused, loaded, or equal.

    Whatever is raised besides `CheckpointError` escapes.
    """
    rng, outcomes, path = np.random.default_rng(seed), Counter[str](), folder / "mutant"
    write_example(path)
    raw = path.read_bytes()
    for _ in range(count):
        mutant = MUTATIONS[int(rng.integers(len(MUTATIONS)))](raw, rng)
        path.write_bytes(mutant)
        outcomes["equal" if mutant == raw else outcome(path)] += 1
    return outcomes


def outcome(path: Path) -> str:
    try:
        load_checkpoint(path)
    except CheckpointError as error:
        return "refused" if str(path) in str(error) else "refused without a name"
    return "loaded"


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as temporary:
        print(dict(fuzz_checkpoints(int(sys.argv[1]), 0, Path(temporary))))
