"""Optimisers whose learning rate, like their state, stays on the device."""

from collections.abc import Iterable
from typing import Any

import torch
from torch import Tensor, nn
from torch.optim import Adam, Optimizer


def make_adam(
    parameters: Iterable[nn.Parameter],
    learning_rate: float,
    betas: tuple[float, float] = (0.9, 0.999),
) -> Adam:
    """Adam, fused. On a GPU its learning rate is a tensor, so that a CUDA graph can read it."""
    own = list(parameters)
    if own[0].device.type != "cuda":
        return Adam(own, learning_rate, betas, fused=True)
    rate: Any = torch.tensor(learning_rate, device=own[0].device)
    return Adam(own, rate, betas, fused=True, capturable=True)


def set_learning_rate(optimizer: Optimizer, learning_rate: float) -> None:
    """Change the learning rate of all parameters, in place where it is a tensor."""
    for group in optimizer.param_groups:
        if isinstance(group["lr"], Tensor):
            group["lr"].fill_(learning_rate)
        else:
            group["lr"] = learning_rate
