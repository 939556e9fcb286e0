"""What every algorithm trains with: random streams, checkpoints, the run, the supervised loop.

A generator is a pure function of the run's seed, its purpose and a number, so no generator state
has to be saved, and batches can be prepared ahead: batch 1,000 is the same whether or not the run
was resumed at 999.

A checkpoint is one safetensors file for the states of a run's parts, written atomically. Tensors
are stored as such; everything else (optimiser settings, counters, environment states) as JSON in
the header of the same file, so that one rename replaces both. Nothing is unpickled.
"""

import json
import math
import signal
import threading
import time
import zlib
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager, closing, contextmanager
from dataclasses import asdict
from enum import IntEnum
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol, Self, TypeVar

import numpy as np
import torch
from safetensors import SafetensorError
from safetensors.torch import load, save
from torch import Tensor, nn
from torch.optim import Optimizer

from magical.errors import (
    CheckpointError,
    DivergedError,
    InvalidConfigError,
    MagicalError,
    RunFolderError,
)
from magical.files import read_bounded, reading, write_atomically
from magical.messages import printable, quoted
from magical.runs import CHECKPOINT, RECORD, read_json, write_json
from magical_baselines.compute import Compute, choose_compute, choose_device, read_compute
from magical_baselines.config import CHECKPOINT_SECONDS, Config, SupervisedConfig
from magical_baselines.run_folder import MetricsWriter

StateDict = dict[str, Any]  # dicts with string keys, lists, tensors, and what JSON can hold

_TENSOR = "__tensor__"
_HEADER = "state"  # the key in the header
MAX_BYTES = 1 << 34  # of a file
_LENGTH = 8  # bytes at the start of a file: its header's length, little-endian
Metrics = Mapping[str, float | str]
Callback = Callable[[int, Metrics], object]  # step, metrics
T = TypeVar("T")

SIGNALS = (signal.SIGINT, signal.SIGTERM)
SAVING_SHARE = 0.05  # of training time is for saving checkpoints, at most
DEPTH = 2  # batches ahead of the one in use


class Purpose(IntEnum):
    """What a stream is for. Runs are reproducible only if no number ever changes its meaning."""

    DEMONSTRATIONS = 0
    INIT = 1
    BATCHES = 2
    ENVIRONMENTS = 3
    ACTIONS = 4
    MINIBATCHES = 5
    DISCRIMINATOR = 6
    PRETRAINING = 7
    NOISE = 8
    PROGRAMS = 9


def stream(seed: int, purpose: Purpose, number: int = 0) -> np.random.Generator:
    """The generator for `number` (a batch, an update, ...) of a purpose."""
    return np.random.default_rng((seed, purpose, number))


def seed_torch(seed: int, purpose: Purpose, number: int = 0) -> None:
    """Seed PyTorch's global generators, of the CPU and the GPUs, from a stream."""
    value = int(stream(seed, purpose, number).integers(2**63))
    # `torch.manual_seed` also records its call stack for each kind of device not in use.
    torch.default_generator.manual_seed(value)
    if torch.cuda.is_available():
        torch.cuda.manual_seed_all(value)


def restored_generators(device: str = "cpu") -> AbstractContextManager[None]:
    """Context manager that restores PyTorch's global generators, of CPU and device, on exit."""
    # Without device numbers, all GPUs of the machine would be initialised.
    return torch.random.fork_rng([torch.cuda.current_device()] if device == "cuda" else [])


@contextmanager
def seeded_init(seed: int, number: int = 0) -> Iterator[None]:
    """Context manager in which PyTorch initialises network `number` from the seed."""
    with restored_generators():
        seed_torch(seed, Purpose.INIT, number)
        yield


def gradient_step(optimizer: Optimizer, loss: Tensor, max_grad_norm: float | None = None) -> None:
    """Minimise a loss by one step; gradients are clipped to an L2 norm, if one is given."""
    optimizer.zero_grad()
    torch.autograd.backward(loss)
    if max_grad_norm is not None:
        parameters = [p for group in optimizer.param_groups for p in group["params"]]
        nn.utils.clip_grad_norm_(parameters, max_grad_norm)
    optimizer.step()


def anneal(optimizer: Optimizer, step: int, steps: int) -> float:
    """Set the learning rate of a step: linear, from the optimiser's own to 0 after `steps`.

    Returns the share that is left.
    """
    left = 1.0 - step / steps
    for group in optimizer.param_groups:
        rate = optimizer.defaults["lr"] * left
        if isinstance(group["lr"], Tensor):  # which a recorded step reads
            group["lr"].fill_(rate)
        else:
            group["lr"] = rate
    return left


class Averages:
    """Weighted means of metrics since the last reset; sums stay on the metrics' device."""

    def __init__(self) -> None:
        self._sums: dict[str, Tensor] = {}
        self._weights: dict[str, int] = {}
        self._start = time.perf_counter()

    def add(self, weight: int, **values: Tensor) -> None:
        """Add scalars with a weight, such as the number of samples that they average."""
        for name, value in values.items():
            weighted = value.detach() * weight
            self._sums[name] = self._sums[name] + weighted if name in self._sums else weighted
            self._weights[name] = self._weights.get(name, 0) + weight

    def reset(self, speed_of: str = "") -> dict[str, float]:
        """Return the means and start over.

        `speed_of`, the name of a metric whose weights count samples, adds samples per second.
        """
        means = {name: (total / self._weights[name]).item() for name, total in self._sums.items()}
        if speed_of:
            seconds = time.perf_counter() - self._start
            means["samples_per_second"] = self._weights[speed_of] / seconds
        self._sums, self._weights, self._start = {}, {}, time.perf_counter()
        return means


class Interrupts:
    """Context manager: the first Ctrl-C or SIGTERM sets `seen`, a second interrupts the program."""

    def __init__(self) -> None:
        self.seen = False
        self._before: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():  # only it may set handlers
            self._before = {number: signal.signal(number, self._note) for number in SIGNALS}
        return self

    def __exit__(self, *error: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _note(self, number: int, frame: object) -> None:
        if self.seen:
            raise KeyboardInterrupt
        self.seen = True


class Stateful(Protocol):
    """What a checkpoint can hold, such as a module or an optimiser."""

    def state_dict(self) -> StateDict:
        """The state that the next step depends on."""

    def load_state_dict(self, state: Any, /) -> Any:
        """Restore what `state_dict` returned."""


def save_checkpoint(path: Path, state: StateDict) -> None:
    """Write nested dicts and lists of tensors and plain values; raises `OSError`.

    An older file at `path` stays intact until the new one is complete.
    """
    tensors: dict[str, Tensor] = {}
    plain = _take_tensors(state, "", tensors)
    stored: set[int] = set()
    for name, tensor in tensors.items():
        memory = tensor.untyped_storage().data_ptr()
        if memory in stored:  # safetensors refuses shared memory
            tensors[name] = tensor.clone()
        stored.add(memory)
    with write_atomically(path) as file:
        file.write(save(tensors, metadata={_HEADER: json.dumps(plain)}))


def load_checkpoint(path: Path) -> StateDict:
    """Read what `save_checkpoint` wrote.

    Raises:
        CheckpointError: the file is missing, or not a checkpoint.
    """
    with reading(path, CheckpointError):
        data = read_bounded(path, MAX_BYTES)
    with restoring(path):
        try:
            tensors = load(data)
        except SafetensorError as error:
            raise CheckpointError(
                f"checkpoint {path} is damaged: expected a safetensors file, found {error}; "
                "restore it from a copy, or train again"
            ) from error
        length = int.from_bytes(data[:_LENGTH], "little")
        metadata = json.loads(data[_LENGTH : _LENGTH + length])["__metadata__"]
        state: StateDict = _put_tensors(json.loads(metadata[_HEADER]), tensors)
        if not isinstance(state, dict):
            raise TypeError(f"expected a dict, found {type(state).__name__}")
    return state


@contextmanager
def restoring(path: Path) -> Iterator[None]:
    """Context manager for restoring state that was read from a checkpoint or a folder with one.

    Raises:
        CheckpointError: the state does not fit: it is of another network or program.
    """
    try:
        yield
    except MagicalError:
        raise
    except (
        *(AttributeError, IndexError, KeyError, OverflowError, RecursionError, RuntimeError),
        *(SafetensorError, TypeError, ValueError, zlib.error),
    ) as error:
        raise CheckpointError(
            f"{path}: the checkpoint is of another network or program; continue with the code that "
            f"saved it, or train again: {type(error).__name__}: {printable(str(error))}"
        ) from error


def state_of(part: Stateful) -> StateDict:
    """The state dict of a part, with string keys."""
    state = part.state_dict()
    if isinstance(part, Optimizer):
        return {**state, "state": {str(index): kept for index, kept in state["state"].items()}}
    return state


def load_state(part: Stateful, state: Mapping[str, Any]) -> None:
    """Restore what `state_of` returned.

    An optimiser's moments get the memory layout of their parameters, so that arithmetic stays
    bit-equal.
    """
    if isinstance(part, Optimizer):
        parameters = [p for group in part.param_groups for p in group["params"]]
        moments = {
            int(index): {
                name: torch.empty_like(parameters[int(index)]).copy_(value)
                if isinstance(value, Tensor) and value.shape == parameters[int(index)].shape
                else value
                for name, value in kept.items()
            }
            for index, kept in state["state"].items()
        }
        state = {"state": moments, "param_groups": state["param_groups"]}
    part.load_state_dict(state)


def _take_tensors(node: Any, name: str, tensors: dict[str, Tensor]) -> Any:
    if isinstance(node, Tensor):
        tensors[name] = node.detach().cpu().contiguous()
        return {_TENSOR: name}
    if isinstance(node, Mapping):
        return {key: _take_tensors(value, f"{name}/{key}", tensors) for key, value in node.items()}
    if isinstance(node, list | tuple):
        return [_take_tensors(value, f"{name}/{i}", tensors) for i, value in enumerate(node)]
    return node


def _put_tensors(node: Any, tensors: Mapping[str, Tensor]) -> Any:
    if isinstance(node, dict):
        if set(node) == {_TENSOR}:
            return tensors[node[_TENSOR]]
        return {key: _put_tensors(value, tensors) for key, value in node.items()}
    if isinstance(node, list):
        return [_put_tensors(value, tensors) for value in node]
    return node


class Run:
    """A run in progress: logs metrics, saves checkpoints and decides when to stop.

    In each step, PyTorch's global random numbers, such as those for dropout, are determined by the
    seed and the step's number. The folder's files are described in `magical.runs`.

    Attributes:
        folder: the run folder.
        config: the configuration.
        saved: the checkpoint to resume from; empty in a new run.
        step: the number of steps (batches or updates) done at the newest checkpoint.
        callbacks: functions called after each line of metrics.
    """

    def __init__(
        self,
        folder: Path,
        config: Config,
        *,
        interrupts: Interrupts | None = None,
        stop_after: int | None = None,
    ) -> None:
        if stop_after is not None and stop_after < 1:
            raise InvalidConfigError(f"stop_after: expected a positive number, found {stop_after}")
        self.folder, self.config = folder, config
        self.callbacks: list[Callback] = []
        self._interrupts = interrupts or Interrupts()
        self.record = read_json(folder / RECORD) if (folder / RECORD).exists() else {}
        path = folder / CHECKPOINT
        self.saved: StateDict = load_checkpoint(path) if path.exists() else {}
        with restoring(folder):
            self.step = int(self.saved["step"]) if self.saved else 0
        self._parts: dict[str, Stateful] = {}
        self._last = math.inf if stop_after is None else self.step + stop_after
        self._saved_at, self._pause = time.monotonic(), float(CHECKPOINT_SECONDS)
        self._metrics = MetricsWriter(folder, self.step)
        seed_torch(config.seed, Purpose.NOISE, self.step)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._metrics.close()

    def describe(self, **facts: Any) -> None:
        """Record facts in `run.json`; raises `RunFolderError` if a resumed run has other ones."""
        for name, fact in facts.items():
            if name in self.record and self.record[name] != fact:
                raise RunFolderError(
                    f"{self.folder}: the run began with other {name}; expected "
                    f"{quoted(self.record[name])}, found {quoted(fact)}; restore what it began "
                    "with, or start a new run"
                )
        self._write_record(facts)

    @cached_property
    def compute(self) -> Compute:
        """Device, precision and threads: as recorded, or chosen from the configuration.

        A run that is resumed on another kind of device chooses again.
        """
        config, device = self.config, choose_device(self.config.device)
        chosen = read_compute(self.record, self.folder)
        if chosen is None or chosen.device != device:
            chosen = choose_compute(device, config.network_precision, config.num_threads)
            self._write_record({"compute": asdict(chosen)})
        if chosen.threads:  # results are bit-equal only for the same number
            torch.set_num_threads(chosen.threads)
        return chosen

    def _write_record(self, facts: Mapping[str, Any]) -> None:
        self.record |= facts
        write_json(self.folder / RECORD, self.record)

    def keep(self, **parts: Stateful) -> bool:
        """Save parts, such as modules and optimisers, in every checkpoint, each under its name.

        They are restored from the checkpoint that the run resumes from, if it has any of them,
        which is returned; raises `CheckpointError` if they do not fit. The part `policy` is
        what `load_policy` loads.
        """
        self._parts |= parts
        found = not self.saved.keys().isdisjoint(parts)
        if found:
            with restoring(self.folder):
                for name, part in parts.items():
                    load_state(part, self.saved[name])
        return found

    def finish_step(
        self, step: int, metrics: Callable[[], Metrics], *, log_every: int = 1, last: bool = False
    ) -> bool:
        """End a step: log metrics, check them, and save a checkpoint, each if due.

        All three are done at the last step, and when the run is interrupted or has to stop.

        Args:
            step: the number of steps done.
            metrics: called to get the metrics since they were last logged.
            log_every: steps between lines of metrics.
            last: whether the algorithm, or a part of it, ends with this step.

        Returns:
            Whether the run stops here.

        Raises:
            DivergedError: metrics or state are not finite; the checkpoint is left unchanged.
        """
        self._require_compute()
        stops = self._interrupts.seen or step >= self._last
        if stops or last or step % log_every == 0:
            found = metrics()
            self._metrics.write(step, found)
            for callback in self.callbacks:
                callback(step, found)
            self._require_finite(step, found)
        every, waited = self.config.checkpoint_every, time.monotonic() - self._saved_at
        if stops or last or (step % every == 0 if every else waited >= self._pause):
            begun = time.monotonic()
            state = {name: state_of(part) for name, part in self._parts.items()}
            self._require_finite(step, state)
            save_checkpoint(self.folder / CHECKPOINT, {**state, "step": step})
            self.step, self._saved_at = step, time.monotonic()
            self._pause = max(CHECKPOINT_SECONDS, (self._saved_at - begun) / SAVING_SHARE)
        seed_torch(self.config.seed, Purpose.NOISE, step)
        return stops

    def _require_compute(self) -> None:
        asked = (f"device {self.config.device}", f"precision {self.config.precision}")
        ignored = [each for each in asked if each in ("device cuda", "precision bfloat16")]
        if ignored and "compute" not in vars(self):
            raise InvalidConfigError(
                f"{' and '.join(ignored)}: this algorithm does not take them, since its "
                "train function does not use run.compute; leave them out"
            )

    def _require_finite(self, step: int, state: Any) -> None:
        """Raise `DivergedError` if any number or tensor in nested dicts and lists is not finite."""
        if not _is_finite(state):
            kept = f"the checkpoint of step {self.step}" if self.step else "no checkpoint"
            raise DivergedError(
                f"training diverged: at step {step} the loss or the weights are not finite; "
                f"{self.folder} keeps {kept}. Try a smaller learning rate or --precision float32"
            )


def _is_finite(node: Any) -> bool:
    if isinstance(node, Tensor):
        return not node.is_floating_point() or bool(torch.isfinite(node).all())
    if isinstance(node, Mapping):
        return all(map(_is_finite, node.values()))
    if isinstance(node, list | tuple):
        return all(map(_is_finite, node))
    return not isinstance(node, float) or math.isfinite(node)


def fit(
    run: Run,
    sample: Callable[[int], T],
    update: Callable[[int, T], Mapping[str, Tensor]],
    *,
    until: int | None = None,
    extra_metrics: Mapping[str, float | str] = {},
) -> bool:
    """Train on batches, from the run's step to the last one, or until the run stops.

    Args:
        run: of a `SupervisedConfig`; its parts to save and restore have been given to `keep`.
        sample: returns batch n, depending only on n; on a CPU, a thread calls it ahead of time.
        update: takes an optimiser step on batch n; returns the metrics, each a mean over it.
        until: the step to end at, by default the last.
        extra_metrics: logged with the others.

    Returns:
        Whether the run stops early.
    """
    config, averages = run.config, Averages()
    assert isinstance(config, SupervisedConfig)
    end = config.num_updates if until is None else until
    numbers = range(run.step, end)
    with closing(prefetch(sample, numbers, ahead=run.compute.device == "cpu")) as batches:
        for number, batch in zip(numbers, batches, strict=False):
            averages.add(config.batch_size, **update(number, batch))
            if run.finish_step(
                number + 1,
                lambda: {**extra_metrics, **averages.reset(speed_of="loss")},
                log_every=config.log_every,
                last=number + 1 == end,
            ):
                return True
    return False


def prefetch(
    make: Callable[[int], T], numbers: Iterable[int], ahead: bool
) -> Generator[T, None, None]:
    """Yield the batches `make(number)`, in order; raises what `make` raises.

    If `ahead`, a thread makes them in advance, on one core, and leaves the others to the main
    thread: this is for batches made by the host. Batches made on a GPU are made on demand, as its
    kernels are queued asynchronously anyway. The thread ends when the generator is closed.
    """
    if not ahead:
        yield from map(make, numbers)
        return
    num_threads = torch.get_num_threads()
    thread = ThreadPoolExecutor(1, "batches", torch.set_num_threads, (1,))
    # The number set in one thread is also the default for threads started later, and a thread takes
    # the default of the time at which it first asks.
    thread.submit(torch.get_num_threads).result()
    torch.set_num_threads(num_threads)
    queue: deque[Future[T]] = deque()
    try:
        for number in numbers:
            queue.append(thread.submit(make, number))
            if len(queue) > DEPTH:
                yield queue.popleft().result()
        while queue:
            yield queue.popleft().result()
    finally:
        thread.shutdown(cancel_futures=True)
