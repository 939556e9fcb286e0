"""Random damage to a published file raises `UnsafeFileError` and nothing else."""

import io
import pickletools
from collections.abc import Callable

import numpy as np

from magical.demos.human.safe_pickle import load
from magical.errors import UnsafeFileError
from tests.demos.conftest import Published, array, observation
from tests.demos.store.fuzz import cut_or_repeat, flip_bits, overwrite

LONGEST = 1000  # characters of a message
OPCODES = [ord(opcode.code) for opcode in pickletools.opcodes]


def example() -> bytes:
    """The pickle of a demonstration with tiny frames, so that most bytes are structure."""
    file = Published(steps=1)
    frames = np.zeros((2, 4, 4, 3), np.uint8)
    file.obs = [observation(array(frame), array(frame)) for frame in frames]
    return file.pickle


def change_opcode(raw: bytes, rng: np.random.Generator) -> bytes:
    """Put another opcode in the place of a byte, or between two."""
    place, opcode = int(rng.integers(len(raw))), bytes([int(rng.choice(OPCODES))])
    return raw[:place] + opcode + raw[place + int(rng.integers(2)) :]


def repeat_part(raw: bytes, rng: np.random.Generator) -> bytes:
    """Repeat a short part many times: nesting, sharing, long stacks."""
    start = int(rng.integers(len(raw)))
    part = raw[start : start + int(rng.integers(1, 12))]
    return raw[:start] + part * int(rng.choice([2, 50, 5000])) + raw[start:]


MUTATIONS: tuple[Callable[[bytes, np.random.Generator], bytes], ...] = (
    flip_bits, cut_or_repeat, overwrite, change_opcode, repeat_part,
)  # fmt: skip


def test_mutants_of_a_pickle_are_loaded_or_refused() -> None:
    rng, raw = np.random.default_rng(1), example()
    assert load(io.BytesIO(raw), np.asarray)["env_name"] == "MoveToCorner-Demo-v0"
    refused = 0
    for _ in range(1000):
        mutant = MUTATIONS[int(rng.integers(len(MUTATIONS)))](raw, rng)
        try:
            load(io.BytesIO(mutant), np.asarray)
        except UnsafeFileError as error:
            refused += 1
            message = str(error)
            assert len(message) < LONGEST
            assert message.isprintable()
    assert 300 < refused < 1000
