"""Optimisers during training."""

from torch.optim import Optimizer


def set_learning_rate(optimizer: Optimizer, learning_rate: float) -> None:
    """Change the learning rate of all parameters."""
    for group in optimizer.param_groups:
        group["lr"] = learning_rate
