"""Device, precision and threads: chosen by measurement, recorded with the run."""

import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import asdict, dataclass
from typing import Any

import torch
from torch import Tensor

from magical.errors import DeviceError
from magical.learning.config import PRECISIONS

WARM_UP, TIMED = 1, 3  # steps per candidate


@dataclass(frozen=True, slots=True)
class Compute:
    """A device, the precision of forward and backward passes, and the number of CPU threads.

    Weights are always float32; 0 threads: PyTorch's own number.
    """

    device: str
    precision: str
    threads: int = 0

    def set_threads(self) -> None:
        """Set PyTorch's number of threads; results are bit-equal for the same number only."""
        if self.threads:
            torch.set_num_threads(self.threads)

    def autocast(self) -> AbstractContextManager[Any]:
        """A context in which networks run in this precision."""
        return torch.autocast(
            self.device, dtype=torch.bfloat16, enabled=self.precision == "bfloat16"
        )

    def to_dict(self) -> dict[str, Any]:
        """Plain data for JSON."""
        return asdict(self)


def choose_device(device: str) -> str:
    """`cuda` or `cpu`; raises `DeviceError` if `cuda` is asked for and there is none."""
    available = torch.cuda.is_available()
    if device == "cuda" and not available:
        raise DeviceError(
            "device cuda: PyTorch finds no CUDA device; use --device cpu, or install a PyTorch "
            "built for CUDA"
        )
    return "cuda" if available and device != "cpu" else "cpu"


def choose_compute(device: str, precision: str, step: Callable[[], Tensor]) -> Compute:
    """Choose the fastest combination of precision and, on a CPU, one or all threads.

    On a busy machine one thread can be faster than several that wait for each other.

    Args:
        device: `cpu` or `cuda`.
        precision: `float32`, `bfloat16`, or `auto` to measure both.
        step: runs the network forward on a batch of the run's size and returns a scalar loss; its
            gradients are accumulated and not cleared.
    """
    names = PRECISIONS[1:] if precision == "auto" else (precision,)
    threads = sorted({torch.get_num_threads(), 1}) if device == "cpu" else [0]
    candidates = [Compute(device, name, count) for name in names for count in threads]
    if len(candidates) == 1:
        return candidates[0]
    with restored_threads():
        return min(candidates, key=lambda compute: step_time(compute, step))


def step_time(compute: Compute, step: Callable[[], Tensor]) -> float:
    """The time of a forward and backward pass in seconds, the shortest of `TIMED`."""
    times = []
    compute.set_threads()
    for _ in range(WARM_UP + TIMED):
        start = time.perf_counter()
        with compute.autocast():
            loss = step()
        torch.autograd.backward(loss.float())
        if compute.device == "cuda":
            torch.cuda.synchronize()
        times.append(time.perf_counter() - start)
    return min(times[WARM_UP:])


@contextmanager
def restored_threads() -> Iterator[None]:
    """A context after which PyTorch's number of threads is what it was before."""
    before = torch.get_num_threads()
    try:
        yield
    finally:
        torch.set_num_threads(before)


@contextmanager
def one_thread() -> Iterator[None]:
    """A context with one CPU thread: for small layers, synchronisation costs more than it gains."""
    with restored_threads():
        torch.set_num_threads(1)
        yield


def zero_inputs(shape: tuple[int, ...], size: int, device: str) -> tuple[Tensor, Tensor]:
    """A batch of network inputs (B, *shape) and tasks (B,), all 0, to measure a network with."""
    tasks = torch.zeros(size, dtype=torch.int64, device=device)
    return torch.zeros(size, *shape, device=device), tasks
