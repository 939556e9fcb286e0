"""Start or resume a run of any algorithm in a run folder."""

import ctypes
import os
import platform
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from magical.errors import InvalidConfigError
from magical.extras import library
from magical.progress import ProgressBar
from magical.runs.folder import TENSORBOARD, opened_folder
from magical.runs.metrics import read_metrics
from magical_baselines.compute import choose_device, cpu_threads, full_float32, gpu_memory_as_error
from magical_baselines.config import Config, find_algorithm
from magical_baselines.policy import TrainedPolicy, load_policy
from magical_baselines.training import Callback, Interrupts, Metrics, Run, restored_generators

TRACKERS = ("tensorboard", "wandb")
# M_TRIM_THRESHOLD, M_TOP_PAD, M_MMAP_THRESHOLD of glibc's allocator, in bytes.
MALLOC = {-1: 1 << 30, -2: 64 << 20, -3: 32 << 20}


@dataclass(frozen=True, slots=True)
class TrainResult:
    """The state of a run when `train` returns."""

    folder: Path
    step: int  # batches or updates done so far
    total: int  # batches or updates of the whole run
    interrupted: bool  # by Ctrl-C or SIGTERM
    metrics: Mapping[str, Any]  # the newest

    @property
    def finished(self) -> bool:
        return self.step >= self.total

    def policy(self) -> TrainedPolicy:
        """Load the trained policy from the folder."""
        return load_policy(self.folder)

    def summary(self) -> dict[str, Any]:
        return {
            "run": str(self.folder),
            "finished": self.finished,
            "interrupted": self.interrupted,
            **self.metrics,
            "total": self.total,
        }


def train(
    config: Config,
    out: Path | str,
    *,
    resume: bool = False,
    stop_after: int | None = None,
    progress: bool = False,
    callback: Callback | None = None,
    track: Sequence[str] = (),
) -> TrainResult:
    """Train a policy in the run folder `out`.

    On Ctrl-C or SIGTERM, the run saves a checkpoint and returns; a second signal interrupts it at
    once. A new run that fails before it has logged or saved anything is removed.

    Args:
        config: an algorithm's configuration, such as `BCConfig.preset("quick", ...)`.
        out: a new or empty folder; with `resume`, one that holds this run.
        resume: continue from the newest checkpoint; on a CPU, bit-equal to an uninterrupted run.
        stop_after: save a checkpoint and return after this many more batches or updates.
        progress: show a progress bar on standard error.
        callback: called as `callback(step, metrics)` after each line of `metrics.jsonl`. An
            exception from it ends training; the run can be resumed from its newest checkpoint.
        track: trackers that also receive the metrics: `tensorboard` (needs the extra), `wandb`.

    Raises:
        RunFolderError: the folder holds something else, or is in use, or the disk is full.
        CheckpointError: the checkpoint is damaged.
        DemonstrationsError, DatasetError: too few demonstrations, or damaged ones.
        DivergedError: the loss or the weights are not finite; the newest good checkpoint is kept.
        InvalidConfigError: settings out of place.
        MissingDependencyError: a tracker's library is not installed.
    """
    folder, algorithm, total = Path(out), find_algorithm(config.algorithm), config.num_updates
    with (
        opened_folder(folder, config.to_dict(), resume),
        prepared_pytorch(config),
        Interrupts() as stop,
        Run(folder, config, interrupts=stop, stop_after=stop_after) as run,
        ProgressBar(config.algorithm, total, transient=False) if progress else nullcontext() as bar,
        opened_trackers(track, run) as trackers,
    ):
        run.callbacks += [*([bar.update] if bar else []), *trackers]
        run.callbacks += [callback] if callback else []
        algorithm.train(config, run)
    newest = (read_metrics(folder) or [{"step": run.step}])[-1]
    return TrainResult(folder, run.step, total, stop.seen, newest)


@contextmanager
def prepared_pytorch(config: Config) -> Iterator[None]:
    """Context manager with PyTorch and the C library set up for training; restores PyTorch."""
    if platform.libc_ver()[0] == "glibc" and "GLIBC_TUNABLES" not in os.environ:
        # By default, glibc returns large blocks to the system, which must then clear every page of
        # the next tensor: a fifth of the training time.
        for parameter, value in MALLOC.items():
            ctypes.CDLL(None).mallopt(parameter, value)
    # Adam's averages are full of numbers below 1e-38 once units are dead, and arithmetic with them
    # is slow.
    flushed = bool(torch.tensor(1e-40) * 1.0 == 0.0)
    torch.set_flush_denormal(True)
    try:
        with (
            cpu_threads(config.threads),
            restored_generators(choose_device(config.device)),
            full_float32(),
            gpu_memory_as_error(),
        ):
            yield
    finally:
        torch.set_flush_denormal(flushed)


@contextmanager
def opened_trackers(names: Sequence[str], run: Run) -> Iterator[list[Callback]]:
    """Context manager whose value are callbacks that send the numbers to these trackers."""
    if unknown := set(names) - set(TRACKERS):
        raise InvalidConfigError(f"track: expected {' or '.join(TRACKERS)}, found {min(unknown)!r}")
    callbacks: list[Callback] = []
    with ExitStack() as stack:
        if "tensorboard" in names:
            library("tensorboard", "tracker tensorboard")
            from torch.utils.tensorboard import SummaryWriter

            # Steps after the checkpoint are logged again.
            writer = SummaryWriter(str(run.folder / TENSORBOARD), purge_step=run.step + 1)
            stack.enter_context(writer)

            def send_scalars(step: int, metrics: Metrics) -> None:
                for name, number in _numbers(metrics).items():
                    writer.add_scalar(name, number, step)

            callbacks.append(send_scalars)
        if "wandb" in names:
            name = run.folder.resolve().name
            session = library("wandb", "tracker wandb").init(
                project=os.environ.get("WANDB_PROJECT", "magical"),
                # Continues the record of the run's earlier sessions.
                id=f"{name}-{run.record.get('began', '')}".replace(":", ""),
                name=name,
                config=run.config.to_dict(),
                resume="allow",
            )
            stack.enter_context(session)
            callbacks.append(lambda step, metrics: session.log(_numbers(metrics), step=step))
        yield callbacks


def _numbers(metrics: Metrics) -> dict[str, Any]:
    return {name: value for name, value in metrics.items() if not isinstance(value, str)}
