"""Start or resume a run of any algorithm."""

import errno
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from magical.errors import RunFolderError
from magical.learning.algorithms import find_algorithm
from magical.learning.config import Config
from magical.learning.devices import kept_threads
from magical.learning.interrupts import Interrupts
from magical.learning.policy import NetworkPolicy, load_policy
from magical.learning.progress import Progress, ProgressBar, Silent
from magical.learning.runs import Run, open_folder, read_metrics


@dataclass(frozen=True, slots=True)
class Trained:
    """What a call of `train` has left behind."""

    folder: Path
    step: int  # batches or updates done, in all
    total: int  # of how many
    interrupted: bool  # by Ctrl-C or a signal
    metrics: Mapping[str, Any]  # the last report

    @property
    def finished(self) -> bool:
        """Whether nothing is left to do."""
        return self.step >= self.total

    def policy(self) -> NetworkPolicy:
        """The trained policy, from the folder."""
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
    progress: Progress | bool = False,
    tensorboard: bool = False,
) -> Trained:
    """Learn a policy as `config` says, in the run folder `out`.

    Args:
        config: an algorithm's configuration, such as `BCConfig.preset("quick", ...)`.
        out: a new or an empty folder; with `resume`, one that holds this run.
        resume: continue from the newest checkpoint; on a CPU bit for bit as if never stopped.
        stop_after: leave a checkpoint and return after so many more batches or updates.
        progress: `True` for a bar on standard error, or something of one's own.
        tensorboard: write the metrics for TensorBoard too (an extra).

    Ctrl-C and SIGTERM leave a checkpoint and return; a second Ctrl-C stops at once.

    Raises:
        RunFolderError: see `runs.open_folder`; or the disk is full.
        DemonstrationsError, DatasetError: too few demonstrations, or damaged ones.
        DivergedError: the loss is not finite; the last good checkpoint stays.
    """
    folder = Path(out)
    algorithm = find_algorithm(config.algorithm)
    bar = ProgressBar(config.algorithm) if progress is True else nullcontext(progress or None)
    with _full_disk_named(folder), kept_threads(), Interrupts() as interrupts:
        open_folder(folder, config, resume)
        with (
            bar as shown,
            Run(
                folder,
                progress=shown or Silent(),
                interrupts=interrupts,
                stop_after=stop_after,
                tensorboard=tensorboard,
            ) as run,
        ):
            algorithm.train(config, run)
    metrics = (read_metrics(folder) or [{"step": run.step}])[-1]
    return Trained(folder, run.step, config.total, interrupts.seen, metrics)


@contextmanager
def _full_disk_named(folder: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.EDQUOT):
            raise
        raise RunFolderError(
            f"{folder}: the disk is full; the last checkpoint is whole. Free some space, then "
            "resume (--resume)"
        ) from error
