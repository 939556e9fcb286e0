"""Checkpoints: one safetensors file for a nested state dict, written atomically.

Tensors are stored as such; everything else (optimiser settings, counters, environment states) is
stored as JSON in the header of the same file, so that one rename replaces both. Nothing is
unpickled.
"""

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
from magical.files import read_regular, reading, write_atomically
from magical.messages import printable

StateDict = dict[str, Any]  # dicts with string keys, lists, tensors, and what JSON can hold

_TENSOR = "__tensor__"
_HEADER = "state"  # the key in the header
MAX_BYTES = 1 << 34  # of a file
_LENGTH = 8  # bytes at the start of a file: its header's length, little-endian


def save_checkpoint(path: Path, state: StateDict) -> None:
    """Write a state dict; an older file at `path` stays intact until the new one is complete.

    Args:
        path: the file.
        state: nested dicts and lists of tensors and plain values.

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
    with write_atomically(path) as file:
        file.write(save(tensors, metadata={_HEADER: json.dumps(plain)}))


def load_checkpoint(path: Path) -> StateDict:
    """Read what `save_checkpoint` wrote.

    Raises:
        CheckpointError: the file is missing or no safetensors file.
        CheckpointMismatchError: it is a safetensors file, but not a checkpoint.
    """
    with reading(path, CheckpointError):
        data = read_regular(path, MAX_BYTES)
    with restoring(path):
        try:
            tensors = load(data)
        except SafetensorError as error:
            raise CheckpointError(
                f"checkpoint {path} is damaged: expected a safetensors file, found {error}; "
                "restore it from a copy, or train again"
            ) from error
        length = int.from_bytes(data[:_LENGTH], "little")
        metadata = json.loads(data[_LENGTH : _LENGTH + length])["__metadata__"]
        state: StateDict = _put_tensors(json.loads(metadata[_HEADER]), tensors)
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
