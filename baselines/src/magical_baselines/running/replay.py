"""Optimiser steps replayed as CUDA graphs."""

from collections.abc import Callable, Sequence

import torch
from torch import Tensor
from torch.optim import Optimizer

Step = Callable[..., dict[str, Tensor]]  # tensors -> values to log


class ReplayedStep:
    """An optimiser step that a GPU replays as a CUDA graph.

    A small network's step is hundreds of kernels, and launching them one by one takes longer than
    running them. The second call records them, and later calls of the same shapes launch them
    together. Besides its inputs, the step may depend only on tensors on the device that stay where
    they are, such as weights, and nothing in it may wait for the device. The values that are
    returned are overwritten by the next call.
    """

    _shapes: Sequence[torch.Size] = ()  # of the inputs of the first call
    _graph: torch.cuda.CUDAGraph | None = None
    _inputs: Sequence[Tensor]  # of the graph, as are the outputs
    _outputs: dict[str, Tensor]

    def __init__(self, optimizer: Optimizer, replayed: bool) -> None:
        """Replay steps of an optimiser, or, unless `replayed`, take each as it is."""
        self._optimizer, self._replayed = optimizer, replayed

    def __call__(self, step: Step, *inputs: Tensor) -> dict[str, Tensor]:
        """Take a step, the same in all calls; returns the values to log."""
        if not self._replayed:
            return step(*inputs)
        shapes = [tensor.shape for tensor in inputs]
        if shapes != self._shapes:
            self._shapes = self._shapes or shapes
            return _take(step, inputs)
        if self._graph is None:
            self._graph = self._recorded(step, inputs)
        for own, new in zip(self._inputs, inputs, strict=True):
            own.copy_(new)
        self._graph.replay()
        return self._outputs

    def _recorded(self, step: Step, inputs: Sequence[Tensor]) -> torch.cuda.CUDAGraph:
        """The graph of the step with copies of the inputs; recording does not take the step."""
        self._inputs = [tensor.clone() for tensor in inputs]
        for group in self._optimizer.param_groups:
            rate = torch.as_tensor(group["lr"], device=inputs[0].device)
            group.update(lr=rate, capturable=True)
        graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(graph):
            self._outputs = _take(step, self._inputs)
        return graph


def _take(step: Step, inputs: Sequence[Tensor]) -> dict[str, Tensor]:
    """Take a step; the values keep nothing of its autograd graph, which belongs to a stream."""
    return {name: value.detach() for name, value in step(*inputs).items()}
