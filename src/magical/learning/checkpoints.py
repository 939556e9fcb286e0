"""Checkpoints: one safetensors file for a tree of tensors and plain values, written atomically.

Tensors are stored as such, everything else (optimiser settings, counters, random generators'
states) as JSON in the same file's header: one rename makes both appear at once. Nothing is
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

Tree = dict[str, Any]  # dicts with string keys, lists, tensors, and what JSON can hold

_TENSOR = "__tensor__"
_HEADER = "tree"


def save_tree(path: Path, tree: Tree) -> None:
    """Write a tree; an older file at `path` stays as it was until the new one is complete.

    Raises:
        OSError: the file cannot be written, or the disk is full.
    """
    tensors: dict[str, Tensor] = {}
    plain = _take_tensors(tree, "", tensors)
    data = save(tensors, metadata={_HEADER: json.dumps(plain)})
    with write_atomically(path) as file:
        file.write(data)


def load_tree(path: Path, device: torch.device | str = "cpu") -> Tree:
    """Read what `save_tree` wrote.

    Raises:
        CheckpointError: missing, damaged, or something else.
    """
    try:
        with safe_open(path, framework="pt", device=str(device)) as file:
            header = json.loads((file.metadata() or {})[_HEADER])
            tree: Tree = _put_tensors(header, file)
    except FileNotFoundError as error:
        raise CheckpointError(f"checkpoint {path}: expected a file, found none") from error
    except (SafetensorError, KeyError, ValueError, TypeError) as error:
        raise CheckpointError(
            f"checkpoint {path} is damaged or of another program ({error!r}); restore it from a "
            "copy or train again"
        ) from error
    return tree


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


def load_module(module: nn.Module, tree: Mapping[str, Any], what: str) -> None:
    """Put saved weights into a module.

    Raises:
        CheckpointError: they are of another network.
    """
    try:
        module.load_state_dict(tree)
    except RuntimeError as error:
        raise CheckpointError(f"{what}: the checkpoint is of another network; {error}") from error


def optimizer_tree(optimizer: Optimizer) -> Tree:
    """An optimiser's state and settings, with string keys."""
    saved = optimizer.state_dict()
    return {
        "state": {str(index): values for index, values in saved["state"].items()},
        "param_groups": saved["param_groups"],
    }


def load_optimizer(optimizer: Optimizer, tree: Mapping[str, Any]) -> None:
    """Continue with what `optimizer_tree` returned.

    Moments get their parameter's memory layout back, so that arithmetic stays bit-equal.
    """
    parameters = [p for group in optimizer.param_groups for p in group["params"]]
    state = {}
    for index, values in tree["state"].items():
        parameter = parameters[int(index)]
        state[int(index)] = {
            name: torch.empty_like(parameter).copy_(value)
            if isinstance(value, Tensor) and value.shape == parameter.shape
            else value
            for name, value in values.items()
        }
    optimizer.load_state_dict({"state": state, "param_groups": tree["param_groups"]})
