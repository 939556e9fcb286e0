"""Published human demonstrations: gzipped pickles of 384 x 384 frames (milbench, 2020)."""

import gzip
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from magical.demos.human.safe_pickle import Array, PublishedRecord, load
from magical.demos.store.trajectory import Trajectory, checked_actions, checked_score, stored_env_id
from magical.envs.action_spec import Actions
from magical.envs.ids import EnvId
from magical.errors import MagicalError, TrajectoryError, UnsafeFileError
from magical.files import open_regular, sha256_sum
from magical.messages import printable, quoted
from magical.scene import View
from magical.scene.constants import FRAME_SIZE, RAW_FRAME_SIZE

MAX_PATH = 1000  # characters of a path in a message
BINNING = RAW_FRAME_SIZE // FRAME_SIZE  # pixels averaged along each axis
_SHAPE = (RAW_FRAME_SIZE, RAW_FRAME_SIZE, 3)


@dataclass(frozen=True, slots=True)
class PublishedDemonstration:
    """A published demonstration of T actions, its frames compressed.

    Attributes:
        env_id: the environment, without a preset.
        actions: (T,) int64.
        score: by the published code's rule.
        source: the file's name and SHA-256 sum.
    """

    env_id: EnvId
    actions: Actions
    score: float
    source: Mapping[str, str]
    packed: Mapping[View, list[NDArray[np.uint8]]]  # T + 1 frames per view

    def frames(self, time: int) -> dict[View, NDArray[np.uint8]]:
        """The frames (384, 384, 3) at time step `time`, 0 to T, in both views."""
        return {view: unpack(frames[time]) for view, frames in self.packed.items()}

    def averaged(self) -> dict[str, NDArray[np.uint8]]:
        """All frames averaged 4 x 4, (T + 1, 96, 96, 3) for each view."""
        return {
            str(view): np.stack([average(unpack(frame)) for frame in frames])
            for view, frames in self.packed.items()
        }

    def trajectory(self, **metadata: Any) -> Trajectory:
        """The trajectory of the averaged frames, without poses."""
        return Trajectory(
            env_id=self.env_id,
            scene=self.env_id.task_spec.demo,  # every episode of a Demo environment has this scene
            actions=self.actions,
            frames=self.averaged(),
            published_code_score=self.score,
            demonstrator="human",
            metadata={**self.source, **metadata},
        )


def read_demonstration(path: Path) -> PublishedDemonstration:
    """Read one published file, using little memory however large the file is.

    Raises:
        UnsafeFileError: the file cannot be read, is not a regular file, is damaged, unpacks to more
            than `MAX_UNPACKED` bytes, or contains anything other than plain data.
        TrajectoryError: its contents are not a valid demonstration in a Demo environment.
    """
    with naming_errors(path):
        source = sha256_sum(path, follow_links=True)
        with open_regular(path, follow_links=True) as file, gzip.open(file) as unpacked:
            data = load(unpacked, pack)
        return _demonstration(data, {"source": path.name, "source_sha256": source})


@contextmanager
def naming_errors(path: Path) -> Iterator[None]:
    """Turn errors in the block into errors that name the file."""
    name = printable(str(path), MAX_PATH)
    try:
        yield
    except UnsafeFileError as error:
        raise UnsafeFileError(f"{name}: {error}") from error
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise UnsafeFileError(f"{name}: expected a complete gzip file, found {error}") from error
    except OSError as error:
        reason = error.strerror or error
        raise UnsafeFileError(f"{name}: cannot be read: {reason}") from error
    except MagicalError as error:
        raise TrajectoryError(f"{name}: {error}") from error


def pack(array: NDArray[Any]) -> NDArray[Any]:
    """Compress a published frame (384, 384, 3) uint8; actions are returned unchanged.

    Raises:
        UnsafeFileError: the array is neither a frame nor actions.
    """
    if array.ndim == 1 and array.dtype.kind in "if":
        return array
    if array.shape != _SHAPE or array.dtype != np.uint8:
        raise UnsafeFileError(
            f"expected actions or uint8 frames {_SHAPE}, found {array.dtype} {array.shape}"
        )
    return np.frombuffer(zlib.compress(array.tobytes(), level=1), np.uint8)


def unpack(packed: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The inverse of `pack`."""
    return np.frombuffer(zlib.decompress(packed.tobytes()), np.uint8).reshape(_SHAPE)


def average(frame: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """A frame (384, 384, 3) averaged 4 x 4 to (96, 96, 3), with halves rounded to even."""
    rows = frame.reshape(FRAME_SIZE, BINNING, -1).sum(axis=1, dtype=np.uint16)
    parts = rows.reshape(FRAME_SIZE, FRAME_SIZE, BINNING, 3)
    total = parts[:, :, 0] + parts[:, :, 1] + parts[:, :, 2] + parts[:, :, 3]
    mean: NDArray[np.uint8] = np.rint(total / BINNING**2).astype(np.uint8)
    return mean


def _demonstration(data: Any, source: Mapping[str, str]) -> PublishedDemonstration:
    if type(data) is not dict or not {"env_name", "score", "trajectory"} <= set(data):
        raise TrajectoryError("expected a dict of env_name, score and trajectory")
    record, env_name, score = data["trajectory"], data["env_name"], data["score"]
    if type(record) is not PublishedRecord:
        raise TrajectoryError("expected a trajectory of acts, obs, rews and infos")
    if type(score) not in (int, float):
        raise TrajectoryError(f"score: expected a number, found {quoted(score)}")
    env_id = stored_env_id(env_name)
    if env_id.variant != "Demo":
        raise TrajectoryError(f"expected a Demo environment, found {quoted(env_name)}")
    acts = record.acts.values if type(record.acts) is Array else None
    if acts is None:
        raise TrajectoryError("acts: expected an array")
    actions, observations = checked_actions("acts", acts), record.obs
    if type(observations) is not list or len(observations) != len(actions) + 1:
        found = len(observations) if type(observations) is list else "none"
        raise TrajectoryError(
            f"obs: expected {len(actions) + 1} observations for {len(actions)} actions, "
            f"found {found}"
        )
    packed = {view: [_frame(observed, str(view)) for observed in observations] for view in View}
    return PublishedDemonstration(env_id, actions, checked_score("score", score), source, packed)


def _frame(observation: Any, view: str) -> NDArray[np.uint8]:
    array = observation.get(view) if type(observation) is dict else None
    if type(array) is not Array or array.values is None or array.values.dtype != np.uint8:
        raise TrajectoryError(f"obs: expected dicts of uint8 frames, found one without {view}")
    return array.values


def file_sum(path: Path, *, follow_links: bool = False) -> str:
    """The SHA-256 sum of a file; empty if the file does not exist or cannot be read."""
    try:
        return sha256_sum(path, follow_links=follow_links)
    except OSError:
        return ""


@cache
def published_sums() -> Mapping[str, str]:
    """SHA-256 sums of the 203 published files, by path in the repository qxcv/magical-data."""
    text = (files("magical.demos.human") / "data" / "human-demos.sha256").read_text()
    lines = (line.split(maxsplit=1) for line in text.splitlines())
    return {path: digest for digest, path in lines}
