"""Device, precision and threads: chosen once, recorded with the run."""

import os
import threading
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import torch
from msgspec import Meta
from torch import Tensor

from magical.errors import DeviceError, RunFolderError
from magical.messages import quoted
from magical.runs.folder import RECORD
from magical.untrusted import convert
from magical_baselines.settings import DEVICES, MAX_THREADS

Device = Literal["cpu", "cuda"]
Precision = Literal["float32", "bfloat16"]
OLDER_INSTRUCTIONS = ("DEFAULT", "NO AVX", "AVX2")  # PyTorch's names


@dataclass(frozen=True, slots=True)
class Compute:
    """A device, the precision of forward and backward passes, and the number of CPU threads.

    Weights are always float32; 0 threads means PyTorch's own number.
    """

    device: Device
    precision: Precision
    threads: Annotated[int, Meta(ge=0, le=MAX_THREADS)] = 0

    def set_threads(self) -> None:
        """Set PyTorch's number of threads; results are bit-equal only for the same number."""
        if self.threads:
            torch.set_num_threads(self.threads)

    def autocast(self) -> AbstractContextManager[Any]:
        """Context manager in which networks run in this precision."""
        return torch.autocast(
            self.device, dtype=torch.bfloat16, enabled=self.precision == "bfloat16"
        )

    def cast(self, inputs: Tensor) -> Tensor:
        """Convert a network's inputs as `autocast` would in each pass."""
        return inputs.bfloat16() if self.precision == "bfloat16" else inputs


def read_compute(record: Mapping[str, Any], folder: Path) -> Compute | None:
    """The device, precision and threads recorded for a run; `None` if not recorded yet.

    Raises:
        RunFolderError: the record is damaged.
    """
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
    whatever else runs on it. `benchmarks/learning.py` measures speeds.

    Args:
        device: `cpu` or `cuda`.
        precision: `float32`, `bfloat16`, or `auto`: bfloat16 if the device has instructions for it.
        threads: number of CPU threads; 0: PyTorch's own number, which is one per physical core
            unless the environment (`OMP_NUM_THREADS`) or the program sets another.
    """
    low = precision == "bfloat16" or (precision == "auto" and has_bfloat16(device))
    if device == "cpu":
        threads = threads or torch.get_num_threads()
    return Compute(device, "bfloat16" if low else "float32", threads)


def has_bfloat16(device: str) -> bool:
    """Whether `cpu` or `cuda` has instructions for multiplying bfloat16 matrices.

    False on a CPU whose newer instructions are switched off by `ATEN_CPU_CAPABILITY`.
    """
    if device == "cuda":
        return bool(torch.cuda.is_bf16_supported(including_emulation=False))
    if torch.backends.cpu.get_cpu_capability() in OLDER_INSTRUCTIONS:
        return False
    # Missing from some supported versions of PyTorch.
    abilities: Mapping[str, Any] = getattr(torch.cpu, "get_capabilities", dict)()
    return bool(abilities.get("amx_bf16") or abilities.get("avx512_bf16"))


_lock = threading.Lock()
_inside = threading.local()  # `depth`: nesting of `restored_threads` in this thread
_num_inside: dict[str, int] = {"threads": 0, "float32": 0}  # threads or calls inside a context
_before: dict[str, Any] = {}  # values before the first of them entered


@contextmanager
def full_float32() -> Iterator[None]:
    """Context manager in which a GPU does not round float32 numbers to TensorFloat-32.

    By default, PyTorch does so in convolutions. Several threads may be inside at the same time.
    """
    cudnn: Any = torch.backends.cudnn  # its parts are not in the type annotations
    parts: tuple[Any, ...] = (cudnn.conv, cudnn.rnn, torch.backends.cuda.matmul)
    with _lock:
        if not _num_inside["float32"]:
            _before["float32"] = [part.fp32_precision for part in parts]
        _num_inside["float32"] += 1
        for part in parts:
            part.fp32_precision = "ieee"
    try:
        yield
    finally:
        with _lock:
            _num_inside["float32"] -= 1
            if not _num_inside["float32"]:
                for part, precision in zip(parts, _before["float32"], strict=True):
                    part.fp32_precision = precision


@contextmanager
def flushed_denormals() -> Iterator[None]:
    """Context manager in which this thread rounds numbers below 1e-38 to 0, if its CPU can.

    Arithmetic with such numbers is slow, and Adam's averages are full of them once units are dead.
    """
    flushed = bool(torch.tensor(1e-40) * 1.0 == 0.0)
    torch.set_flush_denormal(True)
    try:
        yield
    finally:
        torch.set_flush_denormal(flushed)


@contextmanager
def restored_threads() -> Iterator[None]:
    """Context manager that restores PyTorch's number of threads on exit.

    The number set in one thread is also the default for threads started later. If several threads
    are inside at the same time, each therefore restores the number from before the first entered.
    """
    depth = getattr(_inside, "depth", 0)
    with _lock:
        before = torch.get_num_threads()
        if not depth:
            if not _num_inside["threads"]:
                _before["threads"] = before
            _num_inside["threads"] += 1
            before = _before["threads"]
    _inside.depth = depth + 1
    try:
        yield
    finally:
        _inside.depth = depth
        with _lock:
            _num_inside["threads"] -= not depth
            torch.set_num_threads(before)


def num_threads() -> int:
    """The number of CPU threads that PyTorch uses."""
    return torch.get_num_threads()


@contextmanager
def cpu_threads(number: int) -> Iterator[None]:
    """Context manager in which PyTorch uses this number of CPU threads.

    For small layers, one thread is fastest: synchronisation costs more than parallelism gains.
    """
    with restored_threads():
        torch.set_num_threads(number)
        yield


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
