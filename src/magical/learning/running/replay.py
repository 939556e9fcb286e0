"""Optimiser steps replayed as CUDA graphs."""

from collections.abc import Callable, Sequence

import torch
from torch import Tensor
from torch.optim import Optimizer

Step = Callable[..., dict[str, Tensor]]  # tensors -> values to log


class ReplayedStep:
    """An optimiser step that a GPU replays as a CUDA graph; a CPU runs it as it is.

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

    def __init__(self, step: Step, optimizer: Optimizer) -> None:
        self._step, self._optimizer = step, optimizer

    def __call__(self, *inputs: Tensor) -> dict[str, Tensor]:
        """Take a step; returns the values to log."""
        shapes = [tensor.shape for tensor in inputs]
        if inputs[0].device.type == "cpu" or shapes != self._shapes:
            self._shapes = self._shapes or shapes
            return self._step(*inputs)
        if self._graph is None:
            self._graph = self._recorded(inputs)
        for own, new in zip(self._inputs, inputs, strict=True):
            own.copy_(new)
        self._graph.replay()
        return self._outputs

    def _recorded(self, inputs: Sequence[Tensor]) -> torch.cuda.CUDAGraph:
        """The graph of the step with copies of the inputs; recording does not take the step."""
        self._inputs = [tensor.clone() for tensor in inputs]
        for group in self._optimizer.param_groups:
            rate = torch.as_tensor(group["lr"], device=inputs[0].device)
            group.update(lr=rate, capturable=True)
        graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(graph):
            self._outputs = self._step(*self._inputs)
        return graph
