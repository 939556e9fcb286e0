"""The learning rate and the state of optimisers."""

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor
from torch.optim import Optimizer

from magical_baselines.running.checkpoints import StateDict


def set_learning_rate(optimizer: Optimizer, learning_rate: float) -> None:
    """Change the learning rate of all parameters."""
    for group in optimizer.param_groups:
        if isinstance(group["lr"], Tensor):  # which a recorded step reads
            group["lr"].fill_(learning_rate)
        else:
            group["lr"] = learning_rate


def optimizer_state(optimizer: Optimizer) -> StateDict:
    """`optimizer.state_dict()` with string keys."""
    saved = optimizer.state_dict()
    return {**saved, "state": {str(index): values for index, values in saved["state"].items()}}


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
