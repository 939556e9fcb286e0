"""Device, precision and threads: chosen once, recorded with the run."""

from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import asdict, dataclass
from typing import Any

import torch

from magical.errors import DeviceError

OLDER_INSTRUCTIONS = ("DEFAULT", "NO AVX", "AVX2")  # PyTorch's names


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


def choose_compute(device: str, precision: str, threads: int) -> Compute:
    """What a run computes with, from its configuration and the processor's abilities.

    Nothing is measured, so that the same configuration gives the same weights on the same machine,
    whatever else runs on it. `magical bench training` measures, and recommends options.

    Args:
        device: `cpu` or `cuda`.
        precision: `float32`, `bfloat16`, or `auto`: bfloat16 if the device has instructions for it.
        threads: of the CPU; 0: PyTorch's own number, which is one per physical core unless the
            environment (`OMP_NUM_THREADS`) or the program says otherwise.
    """
    if precision == "auto":
        precision = "bfloat16" if has_bfloat16(device) else "float32"
    if device == "cpu":
        threads = threads or torch.get_num_threads()
    return Compute(device, precision, threads)


def has_bfloat16(device: str) -> bool:
    """Whether `cpu` or `cuda` multiplies matrices of bfloat16 with instructions made for it.

    Not on a CPU whose newer instructions are switched off by `ATEN_CPU_CAPABILITY`.
    """
    if device == "cuda":
        return bool(torch.cuda.is_bf16_supported(including_emulation=False))
    if torch.backends.cpu.get_cpu_capability() in OLDER_INSTRUCTIONS:
        return False
    # Not in every PyTorch that is supported.
    abilities: Mapping[str, Any] = getattr(torch.cpu, "get_capabilities", dict)()
    return bool(abilities.get("amx_bf16") or abilities.get("avx512_bf16"))


@contextmanager
def full_float32() -> Iterator[None]:
    """A context in which a GPU does not round float32 numbers to TensorFloat-32.

    PyTorch lets convolutions do so by default.
    """
    cudnn: Any = torch.backends.cudnn  # its parts are not in the type annotations
    parts: tuple[Any, ...] = (cudnn.conv, cudnn.rnn, torch.backends.cuda.matmul)
    before = [part.fp32_precision for part in parts]
    try:
        for part in parts:
            part.fp32_precision = "ieee"
        yield
    finally:
        for part, precision in zip(parts, before, strict=True):
            part.fp32_precision = precision


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
    with cpu_threads(1):
        yield


def num_threads() -> int:
    """The number of CPU threads that PyTorch uses."""
    return torch.get_num_threads()


@contextmanager
def cpu_threads(number: int) -> Iterator[None]:
    """A context in which PyTorch uses this number of CPU threads."""
    with restored_threads():
        torch.set_num_threads(number)
        yield
