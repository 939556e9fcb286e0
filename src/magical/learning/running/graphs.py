"""Training steps as CUDA graphs: recorded once, then launched as a whole.

A training step of these networks is a few hundred kernels of some microseconds each, and launching
them one by one takes longer than running them. A graph launches all of them at once, on the same
memory every time, so inputs are copied to where the recording read them. This has not been run on a
GPU yet; it is off by default, and a step that cannot be recorded is run as it is.
"""

import warnings
from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor

from magical.errors import DeviceError

AUTO, ON, OFF = "auto", "on", "off"
WARM_UP = 3  # calls before the recording: libraries choose their kernels and allocate memory

Step = Callable[..., tuple[Tensor, ...]]


def use_graphs(choice: str, device: str) -> bool:
    """Whether steps are recorded: `on`, `off`, or `auto`, which is on for CUDA devices.

    Raises:
        DeviceError: `on` without a CUDA device.
    """
    if choice == ON and device != "cuda":
        raise DeviceError(
            f"graphs: on needs a CUDA device, and the run computes on the {device}; use auto or off"
        )
    return choice != OFF and device == "cuda"


class GraphedStep:
    """A training step that is called as a function, and replayed as a CUDA graph if enabled.

    The step takes and returns tensors. Whatever else it reads or changes (weights, the optimiser's
    state) must be tensors that stay where they are, and it must not wait for the device. The first
    calls run it as it is; the next one records it. Inputs of other shapes have their own recording.

    Args:
        step: the function.
        enabled: whether to record it; otherwise every call runs it as it is.
        generators: the device's random generators that it uses.
        backend: makes recordings; another one stands in for CUDA in tests.
    """

    def __init__(
        self,
        step: Step,
        enabled: bool,
        generators: Sequence[torch.Generator] = (),
        backend: "Backend | None" = None,
    ) -> None:
        self._step = step
        self._enabled = enabled
        self._generators = generators
        self._record: Backend = backend or CudaRecording
        self._calls: dict[Any, int] = {}  # by the inputs' shapes and types
        self._recordings: dict[Any, Recording] = {}
        self._stream: torch.cuda.Stream | None = None

    def __call__(self, *inputs: Tensor) -> tuple[Tensor, ...]:
        """Run the step. The tensors returned are overwritten by the next call."""
        if not self._enabled:
            return self._step(*inputs)
        key = tuple((tensor.shape, tensor.dtype, tensor.stride()) for tensor in inputs)
        if key not in self._recordings:
            calls = self._calls[key] = self._calls.get(key, 0) + 1
            if calls <= WARM_UP:
                return self._warm_up(inputs)
            try:
                self._recordings[key] = self._record(self._step, list(inputs), self._generators)
            except torch.OutOfMemoryError:
                raise
            except RuntimeError as error:
                self._enabled = False
                warnings.warn(
                    f"graphs: a training step cannot be recorded as a CUDA graph, so steps are run "
                    f"as they are, as with --graphs off: {error}",
                    stacklevel=2,
                )
                return self._step(*inputs)
        return self._recordings[key].replay(inputs)

    def _warm_up(self, inputs: tuple[Tensor, ...]) -> tuple[Tensor, ...]:
        """Run the step on a stream of its own, as recording will."""
        if not torch.cuda.is_available():
            return self._step(*inputs)
        self._stream = self._stream or torch.cuda.Stream()  # type: ignore[no-untyped-call]
        self._stream.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(self._stream):
            outputs = self._step(*inputs)
        torch.cuda.current_stream().wait_stream(self._stream)
        return outputs


class Recording:
    """A recorded step: its inputs' places in memory, and its outputs."""

    def __init__(self, inputs: Sequence[Tensor]) -> None:
        self._places = [torch.empty_like(tensor).copy_(tensor) for tensor in inputs]
        self._last: list[Tensor | None] = [None] * len(inputs)
        self._versions = [-1] * len(inputs)
        self.outputs: tuple[Tensor, ...] = ()

    def launch(self) -> None:
        """Run the recorded step on what is in the inputs' places."""
        raise NotImplementedError

    def replay(self, inputs: Sequence[Tensor]) -> tuple[Tensor, ...]:
        """Copy the inputs to their places, but for those that are there already, and launch."""
        for i, tensor in enumerate(inputs):
            if tensor is not self._last[i] or tensor._version != self._versions[i]:
                self._places[i].copy_(tensor, non_blocking=True)
                self._last[i], self._versions[i] = tensor, tensor._version
        self.launch()
        return self.outputs


class CudaRecording(Recording):
    """A step recorded as a CUDA graph; recording does not run it."""

    def __init__(
        self, step: Step, inputs: Sequence[Tensor], generators: Sequence[torch.Generator]
    ) -> None:
        super().__init__(inputs)
        self._graph = torch.cuda.CUDAGraph()
        for generator in generators:
            self._graph.register_generator_state(generator)
        # Other threads, such as that which prepares batches, may use the GPU meanwhile.
        with torch.cuda.graph(self._graph, capture_error_mode="thread_local"):
            self.outputs = step(*self._places)

    def launch(self) -> None:
        """See `Recording`."""
        self._graph.replay()


Backend = Callable[[Step, Sequence[Tensor], Sequence[torch.Generator]], Recording]
