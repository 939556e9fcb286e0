"""Checkpoints: one safetensors file for a nested state dict, written atomically.

Tensors are stored as such; everything else (optimiser settings, counters, states of
environments) as JSON in the header of the same file, so that one rename replaces both. Nothing is
unpickled.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor, nn
from torch.optim import Optimizer

from magical.errors import CheckpointError
from magical.files import write_atomically

StateDict = dict[str, Any]  # dicts with string keys, lists, tensors, and what JSON can hold

_TENSOR = "__tensor__"
_HEADER = "tree"  # the key in the header


def save_checkpoint(path: Path, state: StateDict) -> None:
    """Write a state dict; an older file at `path` stays as it was until the new one is complete.

    Raises:
        OSError: the file cannot be written, or the disk is full.
    """
    tensors: dict[str, Tensor] = {}
    plain = _take_tensors(state, "", tensors)
    data = save(tensors, metadata={_HEADER: json.dumps(plain)})
    with write_atomically(path) as file:
        file.write(data)


def load_checkpoint(path: Path, device: torch.device | str = "cpu") -> StateDict:
    """Read what `save_checkpoint` wrote.

    Raises:
        CheckpointError: the file is missing, damaged, or no checkpoint.
    """
    try:
        with safe_open(path, framework="pt", device=str(device)) as file:
            header = json.loads((file.metadata() or {})[_HEADER])
            state: StateDict = _put_tensors(header, file)
    except FileNotFoundError as error:
        raise CheckpointError(f"checkpoint {path}: expected a file, found none") from error
    except (SafetensorError, KeyError, ValueError, TypeError) as error:
        raise CheckpointError(
            f"checkpoint {path} is damaged or of another program ({error!r}); restore it from a "
            "copy or train again"
        ) from error
    return state


def _take_tensors(node: Any, name: str, tensors: dict[str, Tensor]) -> Any:
    if isinstance(node, Tensor):
        tensors[name] = node.detach().cpu().contiguous()
        return {_TENSOR: name}
    if isinstance(node, Mapping):
        return {key: _take_tensors(value, f"{name}/{key}", tensors) for key, value in node.items()}
    if isinstance(node, list | tuple):
        return [_take_tensors(value, f"{name}/{i}", tensors) for i, value in enumerate(node)]
    return node


def _put_tensors(node: Any, file: Any) -> Any:
    if isinstance(node, dict):
        if set(node) == {_TENSOR}:
            return file.get_tensor(node[_TENSOR])
        return {key: _put_tensors(value, file) for key, value in node.items()}
    if isinstance(node, list):
        return [_put_tensors(value, file) for value in node]
    return node


def load_module(module: nn.Module, state: Mapping[str, Any], what: str) -> None:
    """`module.load_state_dict(state)`; `what` names the checkpoint in errors.

    Raises:
        CheckpointError: the state is of another network.
    """
    try:
        module.load_state_dict(state)
    except RuntimeError as error:
        raise CheckpointError(f"{what}: the checkpoint is of another network; {error}") from error


def optimizer_state(optimizer: Optimizer) -> StateDict:
    """`optimizer.state_dict()` with string keys."""
    saved = optimizer.state_dict()
    return {
        "state": {str(index): values for index, values in saved["state"].items()},
        "param_groups": saved["param_groups"],
    }


def load_optimizer(optimizer: Optimizer, state: Mapping[str, Any]) -> None:
    """Load what `optimizer_state` returned.

    Moments get the memory layout of their parameters, so that arithmetic stays bit-equal.
    """
    parameters = [p for group in optimizer.param_groups for p in group["params"]]
    moments = {}
    for index, values in state["state"].items():
        parameter = parameters[int(index)]
        moments[int(index)] = {
            name: torch.empty_like(parameter).copy_(value)
            if isinstance(value, Tensor) and value.shape == parameter.shape
            else value
            for name, value in values.items()
        }
    optimizer.load_state_dict({"state": moments, "param_groups": state["param_groups"]})
