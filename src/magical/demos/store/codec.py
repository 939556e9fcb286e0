"""A trajectory as one .npz file: plain arrays that NumPy alone reads, without pickle.

Members: `header` (JSON as uint8), `actions` (T,) uint8, and either `poses` (T + 1, 5 + blocks, 3)
float64 or `frames_allo` and `frames_ego` (T + 1, 96, 96, 3) uint8. Deflate finds the repeated rows
of blocks at rest, and a frame's predecessor, by itself: filters before it gained nothing.
"""

import hashlib
import io
import json
import zipfile
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from magical.demos.store.trajectory import VIEWS, Trajectory
from magical.errors import DatasetError, MagicalError
from magical.scene import Dynamics, Scene

FORMAT = {"format": "magical-trajectory", "version": 1}
MAX_UNPACKED = 512 << 20  # bytes of all members together
_MEMBERS = frozenset({"header", "actions", "poses", *(f"frames_{view}" for view in VIEWS)})
_FIELDS = ("env_id", "seed", "score", "published_code_score", "demonstrator", "metadata")


def encode(trajectory: Trajectory) -> bytes:
    """The file's bytes; the same trajectory always gives the same."""
    header = {
        **FORMAT,
        **{name: getattr(trajectory, name) for name in _FIELDS},
        "scene": trajectory.scene.to_dict(exact=True),
        "dynamics": trajectory.dynamics.to_dict(),
    }
    arrays: dict[str, NDArray[Any]] = {
        "header": np.frombuffer(json.dumps(header).encode(), np.uint8),
        "actions": trajectory.actions.astype(np.uint8),
    }
    if trajectory.poses is not None:
        arrays["poses"] = trajectory.poses
    for view, frames in (trajectory.frames or {}).items():
        arrays[f"frames_{view}"] = frames
    file = io.BytesIO()
    np.savez_compressed(file, allow_pickle=False, **arrays)
    return file.getvalue()


def decode(raw: bytes) -> Trajectory:
    """The trajectory in a file's bytes.

    Raises:
        DatasetError: damaged, of another format or version, or larger than can be.
    """
    try:
        _check_members(raw)
        with np.load(io.BytesIO(raw), allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
        return _trajectory(json.loads(arrays["header"].tobytes()), arrays)
    except DatasetError:
        raise
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError) as error:
        raise DatasetError(f"expected an .npz file, found a damaged one: {error}") from error
    except (KeyError, TypeError, ValueError, OSError, MagicalError) as error:
        raise DatasetError(f"expected a trajectory, found {error!r}") from error


def fingerprint(raw: bytes) -> str:
    """What an encoded trajectory's actions and poses or frames are told apart by.

    Made of the archive's own check sums, so it costs nothing; for finding copies, not forgeries.
    """
    with zipfile.ZipFile(io.BytesIO(raw)) as archive:
        members = sorted((i.filename, i.CRC, i.file_size) for i in archive.infolist())
    shown = repr([member for member in members if member[0] != "header.npy"])
    return hashlib.sha256(shown.encode()).hexdigest()[:16]


def _check_members(raw: bytes) -> None:
    with zipfile.ZipFile(io.BytesIO(raw)) as archive:
        names = {info.filename.removesuffix(".npy") for info in archive.infolist()}
        size = sum(info.file_size for info in archive.infolist())
    if not {"header", "actions"} <= names <= _MEMBERS:
        raise DatasetError(f"expected members {sorted(_MEMBERS)}, found {sorted(names)[:9]}")
    if size > MAX_UNPACKED:
        raise DatasetError(f"expected at most {MAX_UNPACKED} bytes unpacked, found {size}")


def _trajectory(header: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> Trajectory:
    found = {name: header.get(name) for name in FORMAT}
    if found != FORMAT:
        raise DatasetError(f"expected {FORMAT}, found {found}; use a newer version of magical")
    frames = {view: arrays[f"frames_{view}"] for view in VIEWS if f"frames_{view}" in arrays}
    return Trajectory(
        **{name: header[name] for name in _FIELDS},
        scene=Scene.from_dict(header["scene"]),
        dynamics=Dynamics.from_dict(header["dynamics"]),
        actions=arrays["actions"],
        poses=arrays.get("poses"),
        frames=frames or None,
    )
