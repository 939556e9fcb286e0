"""Device, precision and threads: chosen once, recorded with the run."""

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import torch
from msgspec import Meta
from torch import Tensor
from torch.optim import Optimizer

from magical.errors import DeviceError, RunFolderError
from magical.messages import quoted
from magical.runs.folder import RECORD
from magical.untrusted import convert
from magical_baselines.config import MAX_THREADS

DEVICES = ("auto", "cpu", "cuda")
Device = Literal["cpu", "cuda"]
Precision = Literal["float32", "bfloat16"]
OLDER_INSTRUCTIONS = ("DEFAULT", "NO AVX", "AVX2")  # PyTorch's names
Step = Callable[..., dict[str, Tensor]]  # tensors -> values to log


@dataclass(frozen=True, slots=True)
class Compute:
    """A device, the precision of forward and backward passes, and the number of CPU threads.

    Weights are always float32; 0 threads means PyTorch's own number.
    """

    device: Device
    precision: Precision
    threads: Annotated[int, Meta(ge=0, le=MAX_THREADS)] = 0

    def autocast(self) -> AbstractContextManager[Any]:
        """Context manager in which networks run in this precision."""
        return torch.autocast(
            self.device, dtype=torch.bfloat16, enabled=self.precision == "bfloat16"
        )

    def cast(self, inputs: Tensor) -> Tensor:
        """Convert a network's inputs as `autocast` would in each pass."""
        return inputs.bfloat16() if self.precision == "bfloat16" else inputs


def read_compute(record: Mapping[str, Any], folder: Path) -> Compute | None:
    """The compute recorded for a run; `None` if not yet; raises `RunFolderError` if damaged."""
    recorded = record.get("compute")
    what = f"{folder / RECORD}: compute"
    return None if recorded is None else convert(recorded, Compute, what, RunFolderError)


def choose_device(device: str) -> Device:
    """`cuda` or `cpu`; `auto` prefers `cuda`. Raises `DeviceError` if unknown or unavailable."""
    if device not in DEVICES:
        raise DeviceError(f"device {quoted(device)}: expected one of {', '.join(DEVICES)}")
    available = torch.cuda.is_available()
    if device == "cuda" and not available:
        raise DeviceError(
            "device cuda: PyTorch finds no CUDA device; use --device cpu, or install a PyTorch "
            "built for CUDA"
        )
    return "cuda" if available and device != "cpu" else "cpu"


def visible_gpus() -> list[str]:
    """The GPUs that this process may use, each as `CUDA_VISIBLE_DEVICES` would name it."""
    count = torch.cuda.device_count()
    named = os.environ.get("CUDA_VISIBLE_DEVICES")
    return list(map(str, range(count))) if named is None else named.split(",")[:count]


def choose_compute(device: Device, precision: str, threads: int) -> Compute:
    """Choose what a run computes with, from its configuration and the processor's capabilities.

    Nothing is measured, so the same configuration gives the same weights on the same machine,
    whatever else runs on it.

    The precision may be `auto`: bfloat16 if the device has instructions for it. 0 threads are
    PyTorch's own number, by default one per physical core.
    """
    low = precision == "bfloat16" or (precision == "auto" and has_bfloat16(device))
    if device == "cpu":
        threads = threads or torch.get_num_threads()
    return Compute(device, "bfloat16" if low else "float32", threads)


def has_bfloat16(device: str) -> bool:
    """Whether `cpu` or `cuda` has instructions for multiplying bfloat16 matrices."""
    if device == "cuda":
        return bool(torch.cuda.is_bf16_supported(including_emulation=False))
    if torch.backends.cpu.get_cpu_capability() in OLDER_INSTRUCTIONS:  # chosen by the environment
        return False
    # Missing from some supported versions of PyTorch.
    abilities: Mapping[str, Any] = getattr(torch.cpu, "get_capabilities", dict)()
    return bool(abilities.get("amx_bf16") or abilities.get("avx512_bf16"))


@contextmanager
def full_float32() -> Iterator[None]:
    """Context manager in which a GPU does not round float32 numbers to TensorFloat-32.

    By default, PyTorch does so in convolutions.
    """
    cudnn: Any = torch.backends.cudnn  # its parts are not in the type annotations
    parts: tuple[Any, ...] = (cudnn.conv, cudnn.rnn, torch.backends.cuda.matmul)
    before = [part.fp32_precision for part in parts]
    for part in parts:
        part.fp32_precision = "ieee"
    try:
        yield
    finally:
        for part, precision in zip(parts, before, strict=True):
            part.fp32_precision = precision


@contextmanager
def cpu_threads(number: int) -> Iterator[None]:
    """Context manager in which PyTorch uses this number of CPU threads; 0 sets none.

    For small layers, one thread is fastest: synchronisation costs more than parallelism gains.
    """
    before = torch.get_num_threads()
    if number:
        torch.set_num_threads(number)
    try:
        yield
    finally:
        torch.set_num_threads(before)


@contextmanager
def gpu_memory_as_error() -> Iterator[None]:
    """Context manager that raises `DeviceError` if a GPU runs out of memory."""
    try:
        yield
    except torch.OutOfMemoryError as error:
        raise DeviceError(
            "device cuda: not enough memory on the GPU for the run; use smaller batches "
            "(--batch-size, --minibatch-size, --num-envs), or use --device cpu"
        ) from error


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
