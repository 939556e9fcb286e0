"""Checkpoints: one safetensors file for a nested state dict, written atomically.

Tensors are stored as such; everything else (optimiser settings, counters, environment states) is
stored as JSON in the header of the same file, so that one rename replaces both. The header begins
with a SHA-256 digest of all other bytes of the file, which is checked before anything is parsed.
Nothing is unpickled.

A run folder holds the newest checkpoint and the one before it.
"""

import hashlib
import json
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from safetensors import SafetensorError
from safetensors.torch import load, save
from torch import Tensor

from magical.errors import CheckpointError, CheckpointMismatchError, MagicalError
from magical.files import link_atomically, read_regular, reading, write_atomically
from magical.messages import printable
from magical.runs.folder import CHECKPOINT, PREVIOUS

StateDict = dict[str, Any]  # dicts with string keys, lists, tensors, and what JSON can hold

_TENSOR = "__tensor__"
_HEADER = "state"  # the key in the header
MAX_BYTES = 1 << 34  # of a file

# A file begins with the header's length and its JSON; the digest is the JSON's first entry.
_LENGTH = 8  # bytes of the length, little-endian
_METADATA = b'{"__metadata__":{'
_KEY, _AFTER_DIGEST = b'"sha256":"', b'",    '  # 80 bytes with the digest: tensors stay aligned
_START = _LENGTH + len(_METADATA) + len(_KEY)  # of the digest
_END = _START + 2 * hashlib.sha256().digest_size  # in hexadecimal


def save_checkpoint(path: Path, state: StateDict, previous: Path | None = None) -> None:
    """Write a state dict; an older file at `path` stays intact until the new one is complete.

    Args:
        path: the file.
        state: nested dicts and lists of tensors and plain values.
        previous: where the older file is kept, if there is one.

    Raises:
        OSError: the file cannot be written, or the disk is full.
    """
    tensors: dict[str, Tensor] = {}
    plain = _take_tensors(state, "", tensors)
    stored: set[int] = set()
    for name, tensor in tensors.items():
        memory = tensor.untyped_storage().data_ptr()
        if memory in stored:  # safetensors refuses shared memory
            tensors[name] = tensor.clone()
        stored.add(memory)
    before, after = _split_at_digest(save(tensors, metadata={_HEADER: json.dumps(plain)}))
    with write_atomically(path) as file:
        file.writelines((before, _digest(before, after), after))
        if previous and path.exists():
            link_atomically(path, previous)


def load_checkpoint(path: Path) -> StateDict:
    """Read what `save_checkpoint` wrote.

    Raises:
        CheckpointError: the file is missing, damaged, or not a checkpoint.
    """
    with reading(path, CheckpointError):
        data = read_regular(path, MAX_BYTES)
    _check_digest(path, data)
    with restoring(path):
        length = int.from_bytes(data[:_LENGTH], "little")
        metadata = json.loads(data[_LENGTH : _LENGTH + length])["__metadata__"]
        state: StateDict = _put_tensors(json.loads(metadata[_HEADER]), load(data))
        if not isinstance(state, dict):
            raise TypeError(f"expected a dict, found {type(state).__name__}")
    return state


@contextmanager
def restoring(path: Path) -> Iterator[None]:
    """Context manager for restoring state that was read from a checkpoint or a folder with one.

    Raises:
        CheckpointMismatchError: the state does not fit: it is of another network or program.
    """
    try:
        yield
    except MagicalError:
        raise
    except (
        *(AttributeError, IndexError, KeyError, OverflowError, RecursionError, RuntimeError),
        *(SafetensorError, TypeError, ValueError, zlib.error),
    ) as error:
        raise CheckpointMismatchError(
            f"{path}: the checkpoint is of another network or program; continue with the code that "
            f"saved it, or train again: {type(error).__name__}: {printable(str(error))}"
        ) from error


def _split_at_digest(data: bytes) -> tuple[bytes, bytes]:
    """The bytes before and after the digest when it is inserted into a safetensors file."""
    start = _LENGTH + len(_METADATA)
    assert data[_LENGTH:start] == _METADATA
    added = len(_KEY) + (_END - _START) + len(_AFTER_DIGEST)
    length = int.from_bytes(data[:_LENGTH], "little") + added
    return length.to_bytes(_LENGTH, "little") + _METADATA + _KEY, _AFTER_DIGEST + data[start:]


def _digest(before: bytes, after: bytes | memoryview) -> bytes:
    digest = hashlib.sha256(before)
    digest.update(after)
    return digest.hexdigest().encode()


def _check_digest(path: Path, data: bytes) -> None:
    found = _digest(data[:_START], memoryview(data)[_END:])
    if data[_LENGTH:_START] != _METADATA + _KEY or data[_START:_END] != found:
        raise CheckpointError(
            f"checkpoint {path} is damaged or of another program: expected it to begin with the "
            f"SHA-256 digest of its contents, {found.decode()[:12]}..."
        )


def replace_checkpoint(folder: Path, state: StateDict) -> None:
    """Save a run's newest checkpoint; the former newest becomes the previous one.

    Raises:
        OSError: the file cannot be written, or the disk is full.
    """
    save_checkpoint(folder / CHECKPOINT, state, previous=folder / PREVIOUS)


def load_newest_checkpoint(folder: Path) -> StateDict:
    """Read a run's newest checkpoint.

    Raises:
        CheckpointError: it is missing or damaged; the message says if the previous is intact.
        CheckpointMismatchError: it is intact, but not a checkpoint of this program.
    """
    try:
        return load_checkpoint(folder / CHECKPOINT)
    except CheckpointMismatchError:
        raise
    except CheckpointError as error:
        raise CheckpointError(f"{error}; {_alternative(folder)}") from error


def restore_previous_checkpoint(folder: Path) -> None:
    """Replace a run's newest checkpoint, damaged or not, with the previous one.

    Raises:
        CheckpointError: the previous one is missing or damaged; nothing is changed.
    """
    load_checkpoint(folder / PREVIOUS)
    (folder / PREVIOUS).replace(folder / CHECKPOINT)


def _alternative(folder: Path) -> str:
    """What to do when the newest checkpoint cannot be read."""
    previous = folder / PREVIOUS
    try:
        step = load_checkpoint(previous)["step"]
    except (CheckpointError, KeyError):
        return f"{folder} holds no intact checkpoint; restore one from a copy or train again"
    return (
        f"the previous one, {previous} of step {step}, is intact: resume from it with --resume "
        "--previous-checkpoint (resume=True, previous_checkpoint=True)"
    )


def _take_tensors(node: Any, name: str, tensors: dict[str, Tensor]) -> Any:
    if isinstance(node, Tensor):
        tensors[name] = node.detach().cpu().contiguous()
        return {_TENSOR: name}
    if isinstance(node, Mapping):
        return {key: _take_tensors(value, f"{name}/{key}", tensors) for key, value in node.items()}
    if isinstance(node, list | tuple):
        return [_take_tensors(value, f"{name}/{i}", tensors) for i, value in enumerate(node)]
    return node


def _put_tensors(node: Any, tensors: Mapping[str, Tensor]) -> Any:
    if isinstance(node, dict):
        if set(node) == {_TENSOR}:
            return tensors[node[_TENSOR]]
        return {key: _put_tensors(value, tensors) for key, value in node.items()}
    if isinstance(node, list):
        return [_put_tensors(value, tensors) for value in node]
    return node
