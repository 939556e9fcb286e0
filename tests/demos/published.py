"""Published files of human demonstrations, assembled opcode by opcode."""

import gzip
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray


class Published:
    """A published file; every part can be replaced."""

    def __init__(self, steps: int = 2, seed: int = 0) -> None:
        rng = np.random.default_rng(seed)
        shape = (steps + 1, 2, 384, 384, 3)
        self.frames = rng.integers(256, size=shape, dtype=np.uint8)
        self.actions = rng.integers(18, size=steps)
        self.env_name = text("MoveToCorner-Demo-v0")
        self.score = b"G" + np.array(0.75, ">f8").tobytes()
        self.acts = array(self.actions)
        self.obs = [observation(array(allo), array(ego)) for allo, ego in self.frames]

    @property
    def pickle(self) -> bytes:
        rest = b"](" + b"K\x00" * len(self.actions) + b"e](e"
        record = name("milbench.baselines.saved_trajectories", "MILBenchTrajectory")
        obs = b"](" + b"".join(self.obs) + b"e"
        trajectory = record + b"(" + self.acts + obs + rest + b"t\x81"
        items = text("trajectory") + trajectory + text("score") + self.score
        return b"\x80\x04}(" + items + text("env_name") + self.env_name + b"u."

    def replace_first(self, ego: NDArray[Any], shape: Sequence[int] | None = None) -> None:
        """Replace the first egocentric frame."""
        self.obs[0] = observation(array(self.frames[0, 0]), array(ego, shape))

    def write(self, path: Path, level: int = 1) -> Path:
        """Write the gzipped file."""
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(gzip.compress(self.pickle, level))
        return path


def text(value: str) -> bytes:
    return b"\x8c" + bytes([len(value)]) + value.encode()


def name(module: str, attribute: str) -> bytes:
    return text(module) + text(attribute) + b"\x93"


def called(module: str, attribute: str, *arguments: str) -> bytes:
    """STACK_GLOBAL and REDUCE."""
    return name(module, attribute) + b"(" + b"".join(map(text, arguments)) + b"tR"


def array(values: NDArray[Any], shape: Sequence[int] | None = None) -> bytes:
    """An array as the published files hold it; `shape` may differ from that of `values`."""
    kind = {"<i8": ("i8", "<"), "|u1": ("u1", "|"), "<f8": ("f8", "<")}[values.dtype.str]
    made = name("numpy.core.multiarray", "_reconstruct") + name("numpy", "ndarray")
    made += b"K\x00\x85C\x01b\x87R"
    dtype = name("numpy", "dtype") + text(kind[0]) + b"K\x00K\x01\x87R"
    dtype += b"(K\x03" + text(kind[1]) + b"NNNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK\x00tb"
    sizes = b"(" + b"".join(b"J" + np.int32(n).tobytes() for n in shape or values.shape) + b"t"
    raw = values.tobytes()
    data = b"B" + np.uint32(len(raw)).tobytes() + raw
    return made + b"(K\x01" + sizes + dtype + b"\x89" + data + b"tb"


def observation(allo: bytes, ego: bytes) -> bytes:
    views = text("allo") + allo + text("ego") + ego
    return name("collections", "OrderedDict") + b")R(" + views + b"u"
