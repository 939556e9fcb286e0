"""Optimisers whose learning rate, like their state, may stay on the GPU."""

from collections.abc import Iterable
from typing import Any

import torch
from torch import Tensor, nn
from torch.optim import Adam, Optimizer


def make_adam(
    parameters: Iterable[nn.Parameter],
    learning_rate: float,
    betas: tuple[float, float] = (0.9, 0.999),
    recorded: bool = False,
) -> Adam:
    """Adam, fused; where its steps are `recorded`, a CUDA graph reads its learning rate."""
    rate: Any = torch.tensor(learning_rate, device="cuda") if recorded else learning_rate
    return Adam(parameters, rate, betas, fused=True, capturable=recorded)


def set_learning_rate(optimizer: Optimizer, learning_rate: float) -> None:
    """Change the learning rate of all parameters, in place where it is a tensor."""
    for group in optimizer.param_groups:
        if isinstance(group["lr"], Tensor):
            group["lr"].fill_(learning_rate)
        else:
            group["lr"] = learning_rate
