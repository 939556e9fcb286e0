"""Exponential moving averages of a network's weights."""

from collections.abc import Iterable

import torch
from torch import Tensor, nn
from torch.nn.modules.batchnorm import _BatchNorm
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn

STATISTICS_BATCHES = 50  # that batch norm's statistics of averaged weights are from


def weight_average(network: nn.Module, decay: float) -> AveragedModel | None:
    """The average of a network's weights, if there is to be one; 0: none.

    Its batch norm has the network's statistics until `renew_statistics` makes those of its own.
    """
    if not decay:
        return None
    average = get_ema_multi_avg_fn(decay)  # type: ignore[no-untyped-call]
    return AveragedModel(network, multi_avg_fn=average)


@torch.no_grad()
def renew_statistics(network: nn.Module, batches: Iterable[tuple[Tensor, Tensor]]) -> None:
    """Replace batch norm's statistics by those of some batches of images and tasks.

    The network's statistics in training are of other weights than the averaged ones, for which they
    can be far off (Izmailov et al., "Averaging weights leads to wider optima and better
    generalization", UAI 2018, do the same). Afterwards the network is in evaluation mode.
    """
    norms = [module for module in network.modules() if isinstance(module, _BatchNorm)]
    for norm in norms:
        norm.reset_running_stats()
        norm.momentum = None  # a mean over all batches
    network.train()
    for images, tasks in batches:
        network(images, tasks)
    network.eval()
