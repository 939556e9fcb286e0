"""Checkpoints: one safetensors file for the states of a run's parts, written atomically.

Tensors are stored as such; everything else (optimiser settings, counters, environment states) is
stored as JSON in the header of the same file, so that one rename replaces both. Nothing is
unpickled.
"""

import json
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol

import torch
from safetensors import SafetensorError
from safetensors.torch import load, save
from torch import Tensor
from torch.optim import Optimizer

from magical.errors import CheckpointError, CheckpointMismatchError, MagicalError
from magical.files import read_bounded, reading, write_atomically
from magical.messages import printable

StateDict = dict[str, Any]  # dicts with string keys, lists, tensors, and what JSON can hold

_TENSOR = "__tensor__"
_HEADER = "state"  # the key in the header
MAX_BYTES = 1 << 34  # of a file
_LENGTH = 8  # bytes at the start of a file: its header's length, little-endian


class Stateful(Protocol):
    """What a checkpoint can hold, such as a module or an optimiser."""

    def state_dict(self) -> StateDict:
        """The state that the next step depends on."""

    def load_state_dict(self, state: Any, /) -> Any:
        """Restore what `state_dict` returned."""


def save_checkpoint(path: Path, state: StateDict) -> None:
    """Write nested dicts and lists of tensors and plain values; raises `OSError`.

    An older file at `path` stays intact until the new one is complete.
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
        data = read_bounded(path, MAX_BYTES)
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


def state_of(part: Stateful) -> StateDict:
    """The state dict of a part, with string keys."""
    state = part.state_dict()
    if isinstance(part, Optimizer):
        return {**state, "state": {str(index): kept for index, kept in state["state"].items()}}
    return state


def load_state(part: Stateful, state: Mapping[str, Any]) -> None:
    """Restore what `state_of` returned.

    An optimiser's moments get the memory layout of their parameters, so that arithmetic stays
    bit-equal.
    """
    if isinstance(part, Optimizer):
        parameters = [p for group in part.param_groups for p in group["params"]]
        moments = {
            int(index): {
                name: torch.empty_like(parameters[int(index)]).copy_(value)
                if isinstance(value, Tensor) and value.shape == parameters[int(index)].shape
                else value
                for name, value in kept.items()
            }
            for index, kept in state["state"].items()
        }
        state = {"state": moments, "param_groups": state["param_groups"]}
    part.load_state_dict(state)


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
