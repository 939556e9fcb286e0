"""Start or resume a run of any algorithm."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from magical.errors import InvalidConfigError
from magical.progress import ProgressBar
from magical.runs.folder import opened_folder
from magical.runs.metrics import read_metrics
from magical_baselines.algorithms import find_algorithm
from magical_baselines.config import Config
from magical_baselines.policy import TrainedPolicy, load_policy
from magical_baselines.running.allocator import keep_freed_memory
from magical_baselines.running.devices import (
    choose_device,
    flushed_denormals,
    full_float32,
    gpu_memory_as_error,
    restored_threads,
)
from magical_baselines.running.interrupts import Interrupts
from magical_baselines.running.run import Callback, Run
from magical_baselines.running.streams import restored_generators
from magical_baselines.trackers import opened_trackers


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
        """Whether the run is complete."""
        return self.step >= self.total

    def policy(self) -> TrainedPolicy:
        """Load the trained policy from the folder."""
        return load_policy(self.folder)

    def summary(self) -> dict[str, Any]:
        """Plain data for JSON."""
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
        _opened(folder, config, resume),
        Interrupts() as stop,
        ProgressBar(config.algorithm, total, transient=False) if progress else nullcontext() as bar,
        Run(folder, config, interrupts=stop, stop_after=stop_after) as run,
        opened_trackers(track, folder, run.step) as log,
    ):
        if bar:
            run.callbacks.append(bar.update)
        run.callbacks += [log, callback] if callback else [log]
        algorithm.train(config, run)
    newest = (read_metrics(folder) or [{"step": run.step}])[-1]
    return TrainResult(folder, run.step, total, stop.seen, newest)


@contextmanager
def _opened(folder: Path, config: Config, resume: bool) -> Iterator[None]:
    """Context manager with the run folder locked and PyTorch set up for training in it."""
    keep_freed_memory()
    expected, found = (
        find_algorithm(config.algorithm).config.__qualname__,
        type(config).__qualname__,
    )
    if found != expected:
        raise InvalidConfigError(f"{config.algorithm}: expected a {expected}, found a {found}")
    with (
        opened_folder(folder, config.to_dict(), resume),
        restored_threads(),
        restored_generators(choose_device(config.device)),
        full_float32(),
        flushed_denormals(),
        gpu_memory_as_error(),
    ):
        if config.threads:
            torch.set_num_threads(config.threads)
        yield
