"""Where and in which precision to compute: chosen by measurement, recorded with the run."""

import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import asdict, dataclass
from typing import Any

import torch
from torch import Tensor

from magical.errors import DeviceError

DEVICES = ("auto", "cpu", "cuda")
PRECISIONS = ("auto", "float32", "bfloat16")

WARM_UP, TIMED = 1, 3  # steps of each precision in a measurement


@dataclass(frozen=True, slots=True)
class Compute:
    """A device, the precision that networks run in, and threads of one operation on a CPU.

    Weights are always float32; 0 threads: as many as PyTorch is set to.
    """

    device: str
    precision: str
    threads: int = 0

    def set_threads(self) -> None:
        """Make PyTorch use as many threads; results are bit-equal for the same number only."""
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


def choose_precision(device: str, precision: str, step: Callable[[], Tensor]) -> Compute:
    """The asked-for precision, or the faster one; on a CPU, one thread or as many as there are.

    Many threads that wait for each other are slower than one where other programs want the cores
    too. `step` runs the network forward on a batch of the run's size and returns a scalar to
    differentiate; gradients are left as they come.
    """
    names = PRECISIONS[1:] if precision == "auto" else (precision,)
    threads = sorted({torch.get_num_threads(), 1}) if device == "cpu" else [0]
    candidates = [Compute(device, name, count) for name in names for count in threads]
    if len(candidates) == 1:
        return candidates[0]
    with kept_threads():
        return min(candidates, key=lambda compute: step_time(compute, step))


def step_time(compute: Compute, step: Callable[[], Tensor]) -> float:
    """Seconds that the fastest of a few forward and backward passes takes."""
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
def kept_threads() -> Iterator[None]:
    """Afterwards PyTorch uses as many threads as before, whatever was set inside."""
    before = torch.get_num_threads()
    try:
        yield
    finally:
        torch.set_num_threads(before)


@contextmanager
def one_thread() -> Iterator[None]:
    """Inside, a CPU computes on one core: for small layers handing out work takes longer."""
    with kept_threads():
        torch.set_num_threads(1)
        yield
