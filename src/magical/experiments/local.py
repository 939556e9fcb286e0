"""Runs in processes on this machine."""

from collections.abc import Sequence
from concurrent.futures import Future
from functools import partial
from pathlib import Path

from magical.experiments.one_run import finish
from magical.experiments.plan import PlannedRun
from magical.experiments.results import Outcome, Results
from magical.processes import ProcessPool, available_cores


class LocalExecutor:
    """Finishes runs in processes, by default as many as the cores have room for their threads."""

    def __init__(
        self, runs: Sequence[PlannedRun], results: Results, workers: int | None = None
    ) -> None:
        """Create an executor; `workers` is the number of processes."""
        threads = max((run.config.threads for run in runs), default=1)
        self._workers = workers or max(1, available_cores() // threads)
        self._results = results
        self._pool = ProcessPool(self._workers)

    def slots(self) -> int:
        """How many runs can be in progress at a time."""
        return self._workers

    def start(self, run: PlannedRun, demos: Path | None) -> Future[Outcome]:
        """Start a run, which learns from the dataset `demos`."""
        folder = self._results.folder(run)
        return self._pool.submit(partial(finish, folder=folder, demos=demos), run)

    def stop(self) -> None:
        """Have the runs in progress save a checkpoint and end."""
        self._pool.terminate()

    def close(self) -> None:
        """End all processes at once."""
        self._pool.close()
