"""The file format of a trajectory: an .npz archive of arrays that NumPy reads without pickle.

Members: `header` (JSON as uint8), `actions` (T,) uint8, and `poses` (T + 1, 5 + blocks, 3) float64
or `frames_allo` and `frames_ego` (T + 1, 96, 96, 3) uint8, or all of them; and `velocities`, of the
poses' shape, `expert_actions`, `actors` and `policy_actions` (T,) uint8 if the trajectory has them.
Continuous actions are (T, 3) float64. Deflate already exploits the repeated rows of blocks at rest
and the similarity of successive frames: filtering the data first saved nothing.
"""

import hashlib
import io
import json
import math
import re
import struct
import zipfile
from typing import IO, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from magical.demos.store.trajectory import VIEWS, Trajectory, stored_env_id
from magical.errors import DatasetError, TrajectoryError, UnknownNameError
from magical.messages import printable, quoted
from magical.scene import Dynamics, Scene
from magical.scene.actions import PARTS
from magical.scene.constants import FRAME_SIZE
from magical.untrusted import convert

FORMAT = {"format": "magical-trajectory", "version": 1}
MAX_UNPACKED = 512 << 20  # bytes of all members together
MAX_HEADER = 1 << 20  # bytes of JSON
MAX_UNKNOWN = 1000  # characters of a message that lists the known names
MAX_STEPS = 1 << 20  # actions of one trajectory: 36 hours at 8 Hz
MAX_FILE = MAX_UNPACKED + (1 << 20)  # bytes: incompressible data, and the archive's overhead
_FIELDS = ("env_id", "seed", "score", "published_code_score", "demonstrator", "metadata")


class _Member(NamedTuple):
    dtype: str
    trailing: tuple[int | None, ...]  # sizes after the first; None: any
    more_rows: int | None  # than actions; None: any number of rows


_BY_STEP = ("expert_actions", "actors", "policy_actions")  # a row for each action
_CONTINUOUS = "<f8", (len(PARTS),)  # dtype and trailing sizes of continuous actions
_FRAMES = _Member("|u1", (FRAME_SIZE, FRAME_SIZE, 3), more_rows=1)
_MEMBERS = {  # in the order of reading
    "header": _Member("|u1", (), more_rows=None),
    "actions": _Member("|u1", (), more_rows=None),
    **{name: _Member("|u1", (), more_rows=0) for name in _BY_STEP},
    "poses": _Member("<f8", (None, 3), more_rows=1),
    "velocities": _Member("<f8", (None, 3), more_rows=1),
    **{f"frames_{view}": _FRAMES for view in VIEWS},
}
# The header of an .npy file as NumPy writes it for such arrays (format version 1.0).
_NPY_MAGIC = b"\x93NUMPY\x01\x00"
_NPY_HEADER = re.compile(
    rb"\{'descr': '([<|][uf][18])', 'fortran_order': False, "
    rb"'shape': \((\d{1,9}(?:, \d{1,9}){0,3}),?\), \} *\n"
)
_MAX_NPY_HEADER = 256  # bytes; NumPy writes 118
_END_RECORD = struct.Struct("<4s4H2LH")  # the end of a ZIP archive's directory
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_ZIP64_LOCATOR = 20  # bytes; if present, before the end record


def encode(trajectory: Trajectory) -> bytes:
    """Encode a trajectory as a file's bytes; the same trajectory always gives the same bytes.

    Raises:
        TrajectoryError: its metadata is too large for the format.
    """
    header = {
        **FORMAT,
        **{name: getattr(trajectory, name) for name in _FIELDS},
        "scene": trajectory.scene.to_dict(),
        "dynamics": trajectory.dynamics.to_dict(),
    }
    text = json.dumps(header).encode()
    if len(text) > MAX_HEADER:
        raise TrajectoryError(
            f"metadata: expected at most {MAX_HEADER} bytes of JSON with the scene, "
            f"found {len(text)}"
        )
    arrays: dict[str, NDArray[Any]] = {"header": np.frombuffer(text, np.uint8)}
    for name in ("actions", *_BY_STEP):
        if (array := getattr(trajectory, name)) is not None:
            arrays[name] = array if array.dtype.kind == "f" else array.astype(np.uint8)
    for name in ("poses", "velocities"):
        if (array := getattr(trajectory, name)) is not None:
            arrays[name] = array
    for view, frames in (trajectory.frames or {}).items():
        arrays[f"frames_{view}"] = frames
    file = io.BytesIO()
    np.savez_compressed(file, allow_pickle=False, **arrays)
    return file.getvalue()


def decode(raw: bytes) -> Trajectory:
    """Decode a trajectory from a file's bytes, which need not be trusted.

    Sizes, types and shapes are checked before anything is allocated for them.

    Raises:
        DatasetError: the file is damaged, of another format or version, or too large.
    """
    try:
        arrays = _read_arrays(raw)
        return _trajectory(_read_header(arrays["header"]), arrays)
    except DatasetError:
        raise
    except UnknownNameError as error:  # perhaps of a task that is not installed here
        raise DatasetError(printable(str(error), MAX_UNKNOWN)) from error
    except Exception as error:  # zipfile, zlib, json and the constructors raise many kinds
        what = printable(f"{type(error).__name__}: {error}")
        raise DatasetError(
            f"expected a trajectory, found a damaged or another file: {what}"
        ) from error


def fingerprint(raw: bytes) -> str:
    """A fingerprint of the actions and poses or frames of an encoded trajectory.

    Velocities do not count, so an episode recorded without them has the same one. It is computed
    from the archive's checksums, so it costs almost nothing. It detects duplicates, but not
    forgeries.
    """
    uncounted = ("header.npy", "velocities.npy")
    with zipfile.ZipFile(io.BytesIO(raw)) as archive:
        members = sorted((i.filename, i.CRC, i.file_size) for i in archive.infolist())
    content = repr([member for member in members if member[0] not in uncounted])
    return hashlib.sha256(content.encode()).hexdigest()[:16]


def _read_arrays(raw: bytes) -> dict[str, NDArray[Any]]:
    _check_end_record(raw)
    arrays: dict[str, NDArray[Any]] = {}
    with zipfile.ZipFile(io.BytesIO(raw)) as archive:
        infos = _check_members(archive.infolist())
        for name in (name for name in _MEMBERS if name in infos):
            more = _MEMBERS[name].more_rows
            rows = None if more is None else len(arrays["actions"]) + more
            with archive.open(infos[name]) as file:
                arrays[name] = _read_array(file, name, infos[name].file_size, rows)
    return arrays


def _check_end_record(raw: bytes) -> None:
    """Check the size of the archive's directory before `zipfile` reads all of it."""
    end = len(raw) - _END_RECORD.size
    if end < 0:
        raise DatasetError(f"expected an .npz file, found {len(raw)} bytes")
    signature, disk, _, _, members, size, _, comment = _END_RECORD.unpack_from(raw, end)
    zip64 = raw[max(end - _ZIP64_LOCATOR, 0) : end].startswith(b"PK\x06\x07")
    if signature != b"PK\x05\x06" or disk or comment or zip64:
        raise DatasetError("expected an .npz file, found one that was cut off or is damaged")
    if members > len(_MEMBERS) or size > 256 * len(_MEMBERS):
        raise DatasetError(f"expected at most {len(_MEMBERS)} members, found {members}")


def _check_members(infos: list[zipfile.ZipInfo]) -> dict[str, zipfile.ZipInfo]:
    members = {info.filename.removesuffix(".npy"): info for info in infos}
    if not {"header", "actions"} <= set(members) <= set(_MEMBERS) or len(members) < len(infos):
        found = printable(", ".join(sorted(members)))
        raise DatasetError(f"expected members {', '.join(_MEMBERS)}, each once; found {found}")
    limits = {"header": MAX_HEADER, "actions": MAX_STEPS * 8 * len(PARTS)}
    size = sum(info.file_size for info in infos)
    if size > MAX_UNPACKED or any(
        members[name].file_size > limit + _MAX_NPY_HEADER for name, limit in limits.items()
    ):
        raise DatasetError(f"expected at most {MAX_UNPACKED} bytes unpacked, found {size}")
    for name, info in members.items():
        if info.flag_bits & 1 or info.compress_type not in _METHODS:
            raise DatasetError(f"{name}: expected deflated data, found another compression")
    return members


def _read_array(file: IO[bytes], name: str, size: int, rows: int | None) -> NDArray[Any]:
    """Read one .npy member of `size` bytes; `rows` is the expected first size, if known."""
    expected = _MEMBERS[name]
    start = file.read(len(_NPY_MAGIC) + 2)
    length = int.from_bytes(start[-2:], "little")
    if not start.startswith(_NPY_MAGIC) or length > _MAX_NPY_HEADER:
        raise DatasetError(f"{name}: expected an array of .npy format 1.0, found another")
    header = _NPY_HEADER.fullmatch(file.read(length))
    if not header:
        raise DatasetError(f"{name}: expected a plain array without pickled objects, found another")
    dtype, shape = header[1].decode(), tuple(map(int, header[2].split(b", ")))
    if name in ("actions", "expert_actions", "policy_actions") and dtype == _CONTINUOUS[0]:
        expected = _Member(*_CONTINUOUS, expected.more_rows)
    wanted = (rows, *expected.trailing)
    fits = (
        len(shape) == len(wanted)
        and (rows is not None or shape[0] <= MAX_STEPS)
        and all(size in (None, found) for size, found in zip(wanted, shape, strict=True))
    )
    nbytes = math.prod(shape) * np.dtype(expected.dtype).itemsize
    if dtype != expected.dtype or not fits or nbytes + len(start) + length != size:
        raise DatasetError(
            f"{name}: expected {expected.dtype} of shape {wanted}, "
            f"found {dtype} {shape} in {size} bytes"
        )
    data = file.read(nbytes)
    if len(data) != nbytes or file.read(1):  # reading to the end checks the CRC
        raise EOFError(f"{name} ends early")
    return np.frombuffer(data, dtype).reshape(shape)


def _read_header(array: NDArray[Any]) -> dict[str, Any]:
    header: dict[str, Any]
    header = convert(json.loads(array.tobytes().decode()), dict[str, Any], "header", DatasetError)
    if any(header.get(name) != value for name, value in FORMAT.items()):
        found = ", ".join(quoted(header.get(name)) for name in FORMAT)
        raise DatasetError(f"expected {FORMAT}, found {found}; use a newer version of magical")
    return header


def _trajectory(header: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> Trajectory:
    frames = {view: arrays[f"frames_{view}"] for view in VIEWS if f"frames_{view}" in arrays}
    return Trajectory(
        **{name: header[name] for name in _FIELDS} | {"env_id": stored_env_id(header["env_id"])},
        scene=Scene.from_dict(header["scene"]),
        dynamics=Dynamics.from_dict(header["dynamics"]),
        actions=arrays["actions"],
        poses=arrays.get("poses"),
        velocities=arrays.get("velocities"),
        frames=frames or None,
        expert_actions=arrays.get("expert_actions"),
        actors=arrays.get("actors"),
        policy_actions=arrays.get("policy_actions"),
    )
