"""Executing the runs of a plan, locally or on a cluster: when each is started, how each ends."""

import errno
import os
import shlex
from collections import Counter, deque
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import closing, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal, Protocol

from magical.errors import ClusterError, WorkerDiedError
from magical.evaluation import BUILT_IN, Evaluation
from magical.evaluation.rollouts import modules_for
from magical.files import is_out_of_space
from magical.processes import ProcessPool, available_cores
from magical.tasks import with_tasks
from magical_baselines.compute import visible_gpus
from magical_baselines.experiments.demonstrations import (
    open_dataset,
    prepare_demonstrations,
    require_same_demonstrations,
)
from magical_baselines.experiments.display import Display
from magical_baselines.experiments.one_run import (
    evaluate_reference,
    finish,
    modules_of_run,
    record_failure,
    reference_folder,
)
from magical_baselines.experiments.plan import PlannedRun
from magical_baselines.experiments.results import (
    DONE,
    FAILED,
    Outcome,
    Results,
    opened,
)
from magical_baselines.training import Interrupts

TRIES = 3  # of a run that was ended by the cluster, not by its own failure
POLL = 1.0  # seconds between checks for signals, and between refreshes of the display


class Executor(Protocol):
    """A place where runs are executed."""

    def slots(self) -> int:
        """How many runs can be in progress at a time."""

    def start(self, run: PlannedRun, demos: Path | None) -> Future[Outcome]:
        """Start a run, which learns from the dataset `demos`."""

    def stop(self) -> None:
        """Have the runs in progress save a checkpoint and end."""

    def close(self) -> None:
        """End everything at once."""


class LocalExecutor:
    """Processes on this machine, by default as many as there are cores for their threads.

    Each sees one of the machine's GPUs, if there are any; they take turns.
    """

    def __init__(self, runs: Sequence[PlannedRun], results: Results, workers: int | None) -> None:
        threads = max((run.config.threads for run in runs), default=1)
        self._workers = workers or max(1, available_cores() // threads)
        self._results = results
        gpus = [{"CUDA_VISIBLE_DEVICES": gpu} for gpu in visible_gpus()]
        # No more processes than runs: they could be those of the same GPU.
        self._pool = ProcessPool(min(self._workers, len(runs)), gpus or [{}])

    def slots(self) -> int:
        """The number of processes."""
        return self._workers

    def start(self, run: PlannedRun, demos: Path | None) -> Future[Outcome]:
        """Start a run in a process."""
        folder = self._results.folder(run)
        work = with_tasks(partial(finish, folder=folder, demos=demos), modules_of_run(run))
        return self._pool.submit(work, run)

    def stop(self) -> None:
        """Send SIGTERM."""
        self._pool.terminate()

    def close(self) -> None:
        """End all processes."""
        self._pool.close()


@dataclass(frozen=True, slots=True, kw_only=True)
class Resources:
    """Where runs are executed, and with what.

    Attributes:
        executor: processes on this machine, or tasks of a Ray cluster.
        address: the address of a Ray cluster; by default one running on this machine, or a new one.
        workers: processes on this machine, local or of a new Ray cluster.
        gpus: the share of a GPU that Ray reserves for each run.
    """

    executor: Literal["local", "ray"] = "local"
    address: str | None = None
    workers: int | None = None
    gpus: float = 0.0


@dataclass(frozen=True, slots=True)
class Summary:
    """How the runs of a plan ended.

    Attributes:
        out: the results folder.
        counts: the number of runs by state: `done` and `failed`; the rest are not finished.
        total: the number of runs in the plan.
        interrupted: whether Ctrl-C or SIGTERM was received.
    """

    out: Path
    counts: Counter[str]
    total: int
    interrupted: bool

    @property
    def complete(self) -> bool:
        """Whether every run is done."""
        return self.counts[DONE] == self.total

    def __str__(self) -> str:
        """One line for the command line."""
        failed = self.counts[FAILED]
        text = f"{self.out}: {self.counts[DONE]} of {self.total} runs done"
        if failed:
            text += f", {failed} failed (magical status {shlex.quote(str(self.out))} shows why; "
            text += "--retry-failed reruns them)"
        if self.counts[DONE] + failed < self.total:
            text += "; run the same command again to continue with the others"
        return text

    def to_dict(self) -> dict[str, Any]:
        """Plain data for JSON."""
        return {
            "out": str(self.out),
            "runs": self.total,
            "done": self.counts[DONE],
            "failed": self.counts[FAILED],
            "interrupted": self.interrupted,
        }


def execute(
    runs: Sequence[PlannedRun],
    out: Path,
    resources: Resources = Resources(),
    *,
    references: Sequence[tuple[str, Evaluation]] = (),
    retry_failed: bool = False,
    command: Sequence[str] = (),
) -> Summary:
    """Finish all runs that are not done yet, in a results folder.

    Ctrl-C and SIGTERM leave checkpoints and return; a second one interrupts at once.

    Args:
        runs: the runs of a plan.
        out: the results folder, new or of an earlier version of the plan.
        resources: where to execute them.
        references: the plan's reference policies; evaluated here, on cores that no run needs.
        retry_failed: run failed runs again; they continue from their last checkpoint.
        command: the words of the command that does this, but for the folder, for `magical status`.

    Raises:
        ResultsError: see `magical_baselines.experiments.results.opened`; or no space is left.
        ClusterError: the Ray cluster cannot be reached.
        DatasetError, DemonstrationsError: no demonstrations to learn from, or too few.
    """
    with Interrupts() as stop, opened(out, runs) as results:
        states = {run: results.state(run) for run in runs}
        require_same_demonstrations([run for run in runs if states[run] == DONE], results)
        again = (None, FAILED) if retry_failed else (None,)
        waiting = [run for run in runs if states[run] in again]
        open_dataset(waiting, results)  # if it refuses the plan, the previous one stays listed
        results.write_plan(runs, list(map(reference_folder, references)), command)

        def go_on(_: int) -> None:
            if stop.seen:
                raise _Interrupted

        with suppress(_Interrupted), closing(_References(references, results, resources)) as others:
            if waiting:
                with closing(_executor(waiting, results, resources)) as executor:
                    demos = prepare_demonstrations(waiting, results, resources.workers, go_on)
                    with Display(out) as display:
                        _finish_all(waiting, demos, results, executor, display, stop, others)
            others.finish(go_on)
        counts = Counter(filter(None, map(results.state, runs)))
        return Summary(results.path, counts, len(runs), stop.seen)


class _Interrupted(Exception):
    """A signal arrived outside training; what was generated or evaluated is kept."""


def _finish_all(
    runs: Sequence[PlannedRun],
    demos: Path | None,
    results: Results,
    executor: Executor,
    display: Display,
    stop: Interrupts,
    references: "_References",
) -> None:
    waiting = deque(runs)
    lost: Counter[PlannedRun] = Counter()
    running: dict[Future[Outcome], PlannedRun] = {}
    stopping = full = False  # full: no space is left
    while running or (waiting and not (full or stop.seen)):
        while waiting and not (full or stop.seen) and len(running) < executor.slots():
            run = waiting.popleft()
            running[executor.start(run, demos)] = run
            results.write_progress(running.values(), executor.slots())
        if not (waiting or stop.seen):
            references.start(executor.slots() - len(running))
        ended, _ = wait(running, POLL, FIRST_COMPLETED)
        for future in ended:
            run = running.pop(future)
            outcome = _outcome(run, future, results, stopping or stop.seen)
            full = full or outcome.state == "no space"
            if outcome.state == "lost":
                lost[run] += 1
                if lost[run] >= TRIES:
                    raise ClusterError(
                        f"the cluster lost a run {TRIES} times, last with: {outcome.error}. No run "
                        "failed by itself: repair the cluster, then run the same command again"
                    )
                waiting.append(run)
            display.ended(run, outcome)
            results.write_progress(running.values(), executor.slots())
        display.refresh()
        if (stop.seen or full) and not stopping:
            stopping = True
            executor.stop()
    if full:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))  # `opened` says what to do


class _References:
    """Reference policies, each evaluated in a process on this machine."""

    def __init__(
        self,
        references: Sequence[tuple[str, Evaluation]],
        results: Results,
        resources: Resources,
    ) -> None:
        evaluate = partial(evaluate_reference, results=results.path)
        self._waiting = deque(
            (with_tasks(evaluate, modules), (name, evaluation))
            for name, evaluation in references
            for modules in [modules_for(BUILT_IN[name](), list(evaluation.by_task))]
        )
        self._started: dict[Future[None], str] = {}
        self._pool = ProcessPool(min(resources.workers or available_cores(), len(references)))

    def start(self, slots: int) -> None:
        """Start evaluations until there are as many in progress as slots."""
        free = slots - sum(not future.done() for future in self._started)
        for _ in range(min(free, len(self._waiting))):
            work, reference = self._waiting.popleft()
            self._started[self._pool.submit(work, reference)] = reference_folder(reference)

    def finish(self, progress: Callable[[int], None]) -> None:
        """Evaluate the rest; `progress` is called meanwhile, and may raise."""
        self.start(len(self._started) + len(self._waiting))
        while not all(future.done() for future in self._started):
            progress(0)
            wait(self._started, POLL)
        for future, name in self._started.items():
            try:
                future.result()
            except WorkerDiedError as error:
                raise WorkerDiedError(
                    f"{error} while it evaluated {name}, all else is done; run the same command "
                    "again"
                ) from error

    def close(self) -> None:
        """End what is in progress."""
        self._pool.close()


def _outcome(run: PlannedRun, future: Future[Outcome], results: Results, stopping: bool) -> Outcome:
    """How a run ended; a process that died is recorded as a failure unless it was told to end."""
    error = future.exception()
    if error is None:
        return future.result()
    if stopping:
        return Outcome("interrupted")
    if not isinstance(error, Exception):
        raise error
    if is_out_of_space(error):
        return Outcome("no space", error=str(error))
    return Outcome("failed", error=record_failure(run, results.folder(run), error))


def _executor(runs: Sequence[PlannedRun], results: Results, resources: Resources) -> Executor:
    if resources.executor == "ray":
        from magical_baselines.experiments.ray_cluster import RayExecutor  # an optional library

        return RayExecutor(runs, results, resources.address, resources.workers, resources.gpus)
    return LocalExecutor(runs, results, resources.workers)
