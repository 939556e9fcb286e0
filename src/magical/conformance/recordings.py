"""The recordings in the package: where they are, and whether they are intact."""

import hashlib
from pathlib import Path

from magical.errors import RecordingError

DATA = Path(__file__).parent / "data"
SUMS = "SHA256SUMS"  # in the format of `sha256sum`
RECORDINGS = {
    "frames": ("frames-96.npz", "frames-384.npz"),
    "motions": ("motions.json",),
    "scenes": ("scenes.json.gz",),
    "scores": ("scores.json.gz",),
}


def recording_path(name: str) -> Path:
    """The path of a recording in the package.

    Raises:
        RecordingError: The file, or the list of SHA-256 sums beside it, is missing or damaged.
    """
    path = DATA / name
    try:
        found = hashlib.sha256(path.read_bytes()).hexdigest()
        expected = _sums().get(name, "none")
    except OSError as error:
        raise _damaged(path, f"cannot be read: {error}") from error
    if found != expected:
        raise _damaged(path, f"expected SHA-256 {expected} ({SUMS}), found {found}")
    return path


def _sums() -> dict[str, str]:
    """The SHA-256 of each recording by its file name."""
    lines = (DATA / SUMS).read_text(encoding="utf-8", errors="replace").splitlines()
    words = (line.split() for line in lines)
    return {pair[1]: pair[0] for pair in words if len(pair) == 2}


def _damaged(path: Path, found: str) -> RecordingError:
    return RecordingError(
        f"{path}: {found}. This file belongs to the package: reinstall the package, or in a clone "
        f"restore the folder {path.parent.name} with git"
    )
