"""Published human demonstrations: gzipped pickles of 384 x 384 frames (milbench, 2020)."""

import gzip
import zlib
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from magical.demos.human.safe_pickle import Array, Record, load
from magical.demos.store.trajectory import MAX_NAME, Trajectory
from magical.envs.ids import parse_env_id
from magical.errors import MagicalError, TrajectoryError, UnsafeFileError
from magical.files import open_regular, sha256_sum
from magical.messages import printable, quoted
from magical.scene import View
from magical.scene.constants import FRAME_SIZE, RAW_FRAME_SIZE

MAX_UNPACKED = 512 << 20  # bytes; the largest published file unpacks to 213 MB
MAX_PATH = 1000  # characters of a path in a message
BINNING = RAW_FRAME_SIZE // FRAME_SIZE  # pixels averaged along each axis
_CHUNK = 1 << 17
_VIEWS = (str(View.ALLO), str(View.EGO))


def read_published(path: Path, max_bytes: int = MAX_UNPACKED) -> Trajectory:
    """Read one published file; frames are averaged 4 x 4 down to 96 x 96, exactly.

    The appendix's score is unknown (None), since the files hold frames, not poses. Memory use is
    that of the reduced frames, however large the file is.

    Args:
        path: the file.
        max_bytes: the most that it may unpack to.

    Raises:
        UnsafeFileError: it is not a regular file, is damaged, unpacks to more than `max_bytes`, or
            holds anything but a demonstration's plain data.
        TrajectoryError: its arrays do not fit together.
    """
    name = printable(str(path), MAX_PATH)
    try:
        with open_regular(path, follow_links=True) as file:
            source = sha256_sum(file)
            check_unpacked_size(file, max_bytes)
            file.seek(0)
            with gzip.open(file) as unpacked:
                data = load(unpacked, average)
        return _trajectory(data, {"source": path.name, "source_sha256": source})
    except UnsafeFileError as error:
        raise UnsafeFileError(f"{name}: {error}") from error
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise UnsafeFileError(f"{name}: expected a complete gzip file, found {error}") from error
    except OSError as error:
        reason = error.strerror or error
        raise UnsafeFileError(f"{name}: cannot be read: {reason}") from error
    except MagicalError as error:
        raise TrajectoryError(f"{name}: {error}") from error


def check_unpacked_size(file: IO[bytes], max_bytes: int) -> None:
    """Count what a gzip file unpacks to, without keeping it in memory.

    Raises:
        UnsafeFileError: it is more than `max_bytes`.
        EOFError, zlib.error, gzip.BadGzipFile: the file is damaged.
    """
    file.seek(0)
    count = 0
    with gzip.open(file) as unpacked:
        while chunk := unpacked.read(_CHUNK):
            count += len(chunk)
            if count > max_bytes:
                raise UnsafeFileError(
                    f"unpacks to more than {max_bytes} bytes, more than any published "
                    "demonstration; refused before reading it"
                )


def average(array: NDArray[Any]) -> NDArray[Any]:
    """A published frame (384, 384, 3) uint8 averaged 4 x 4, halves to even; actions unchanged.

    Raises:
        UnsafeFileError: any other array.
    """
    if array.ndim == 1 and array.dtype.kind in "if":
        return array
    if array.shape != (RAW_FRAME_SIZE, RAW_FRAME_SIZE, 3) or array.dtype != np.uint8:
        raise UnsafeFileError(
            f"expected actions or uint8 frames ({RAW_FRAME_SIZE}, {RAW_FRAME_SIZE}, 3), "
            f"found {array.dtype} {array.shape}"
        )
    rows = array.reshape(FRAME_SIZE, BINNING, -1).sum(axis=1, dtype=np.uint16)
    parts = rows.reshape(FRAME_SIZE, FRAME_SIZE, BINNING, 3)
    total = parts[:, :, 0] + parts[:, :, 1] + parts[:, :, 2] + parts[:, :, 3]
    odd = (total >> 4) & 1
    mean: NDArray[Any] = ((total + 7 + odd) >> 4).astype(np.uint8)
    return mean


def _trajectory(data: Any, metadata: Mapping[str, Any]) -> Trajectory:
    if type(data) is not dict or not {"env_name", "score", "trajectory"} <= set(data):
        raise TrajectoryError("expected a dict of env_name, score and trajectory")
    record, env_name, score = data["trajectory"], data["env_name"], data["score"]
    if type(record) is not Record or type(env_name) is not str or len(env_name) > MAX_NAME:
        raise TrajectoryError("expected a trajectory of acts, obs, rews and infos, and a name")
    if type(score) not in (int, float):
        raise TrajectoryError(f"score: expected a number, found {quoted(score)}")
    env_id = parse_env_id(env_name).without_preset
    if env_id.variant != "Demo":
        raise TrajectoryError(f"expected a Demo environment, found {quoted(env_name)}")
    actions = _values(record.acts)
    return Trajectory(
        env_id=env_id,
        scene=env_id.task_spec.demo,  # every episode of a Demo environment has this scene
        actions=actions,
        frames={view: _stacked(record.obs, view, len(actions)) for view in _VIEWS},
        published_code_score=score,
        demonstrator="human",
        metadata=metadata,
    )


def _values(array: Any) -> NDArray[Any]:
    if type(array) is not Array or array.values is None or array.values.ndim != 1:
        raise TrajectoryError("acts: expected a one-dimensional array")
    return array.values


def _stacked(observations: Any, view: str, actions: int) -> NDArray[np.uint8]:
    if type(observations) is not list or len(observations) != actions + 1:
        found = len(observations) if type(observations) is list else "none"
        raise TrajectoryError(
            f"obs: expected {actions + 1} observations for {actions} actions, found {found}"
        )
    frames = [_frame(observation, view) for observation in observations]
    return np.stack(frames)


def _frame(observation: Any, view: str) -> NDArray[np.uint8]:
    array = observation.get(view) if type(observation) is dict else None
    if type(array) is not Array or array.values is None or array.values.ndim != 3:
        raise TrajectoryError(f"obs: expected dicts of uint8 frames, found one without {view}")
    return array.values


@cache
def published_sums() -> Mapping[str, str]:
    """SHA-256 of the 203 published files by their path in the repository qxcv/magical-data."""
    text = (files("magical.demos.human") / "data" / "human-demos.sha256").read_text()
    lines = (line.split(maxsplit=1) for line in text.splitlines())
    return {path: digest for digest, path in lines}
