"""Executing a plan: demonstrations for all runs, then each run in a process of its own."""

import errno
import os
import pickle
import signal
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing, contextmanager, suppress
from dataclasses import asdict
from itertools import chain, cycle, islice
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Lock
from typing import TYPE_CHECKING, Any

from magical.demos.dataset import Dataset, DatasetWriter
from magical.demos.generate import generate
from magical.envs.ids import EnvId
from magical.errors import ClusterError, DemonstrationsError, RunFolderError, WorkerDiedError
from magical.messages import for_terminal
from magical.processes import available_cores
from magical.runs import CONFIG, PLAN, REFERENCES, RUNS, is_run, read_json, write_json
from magical_baselines.compute import visible_gpus
from magical_baselines.config import DemonstrationConfig
from magical_baselines.experiments import one_run
from magical_baselines.experiments.one_run import NO_SPACE, Planned, modules_needed, write_failure
from magical_baselines.experiments.plan import PlannedReference, PlannedRun
from magical_baselines.experiments.status import DEMOS, DONE, FAILED, read_result
from magical_baselines.run_folder import differences, is_out_of_space, owned
from magical_baselines.training import Interrupts

if TYPE_CHECKING:
    from magical_baselines.experiments.cluster import RayTasks

POLL = 0.2  # seconds between checks for signals
# A run sets its number of threads; libraries that start one for each core only cost memory.
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


class Processes:
    """A process on this machine for each run, which take turns on its GPUs.

    There are `workers` at a time, by default as many as there are cores for the runs' threads. A
    process that is killed costs its run alone. All end with this process, however it ends.
    """

    def __init__(self, runs: Sequence[PlannedRun], workers: int | None = None) -> None:
        threads = max((run.config.threads for run in runs), default=1)
        count = workers or max(1, available_cores() // threads)
        self._threads = ThreadPoolExecutor(count)
        self._environs: SimpleQueue[Mapping[str, str]] = SimpleQueue()
        gpus = [{"CUDA_VISIBLE_DEVICES": gpu} for gpu in visible_gpus()]
        for environ in islice(cycle(gpus or [{}]), count):
            self._environs.put(environ)
        self._children: set[subprocess.Popen[bytes]] = set()
        self._lock, self._stopped = Lock(), False

    def submit(self, work: Planned, folder: Path, demos: Path | None) -> "Future[None]":
        """Call `one_run.finish` in a process; `WorkerDiedError` in the future if it is killed."""
        message = pickle.dumps(modules_needed(work)) + pickle.dumps((work, folder, demos))
        return self._threads.submit(self._run, message)

    def _run(self, message: bytes) -> None:
        environ = self._environs.get()
        try:
            with self._lock:
                if self._stopped:
                    return
                child = _start(environ)
                self._children.add(child)
            with child, suppress(BrokenPipeError):
                assert child.stdin is not None
                child.stdin.write(message)
                child.stdin.flush()  # and left open: its end tells the child that this process died
                child.wait()
            self._children.discard(child)
        finally:
            self._environs.put(environ)
        if child.returncode == NO_SPACE:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        if (code := child.returncode) > 0:
            raise WorkerDiedError(f"its process ended with exit status {code}")
        if code < 0:
            name = signal.Signals(-code).name
            raise WorkerDiedError(f"its process was killed by signal {-code} ({name})")

    def stop(self) -> None:
        """Start nothing more, and have runs in progress save a checkpoint and end, by SIGTERM."""
        with self._lock:
            self._stopped = True
            for child in list(self._children):
                child.terminate()

    def close(self) -> None:
        """End everything at once."""
        self.stop()
        for child in list(self._children):
            child.kill()
        self._threads.shutdown(cancel_futures=True)


def _start(environ: Mapping[str, str]) -> "subprocess.Popen[bytes]":
    path = os.pathsep.join(str(Path(entry).absolute()) for entry in sys.path)
    return subprocess.Popen(
        [sys.executable, "-P", "-m", one_run.__name__],
        stdin=subprocess.PIPE,
        stdout=2,  # standard output is for results
        env={**os.environ, **ONE_THREAD, **environ, "PYTHONPATH": path},
        process_group=0 if sys.platform != "win32" else None,  # a terminal's Ctrl-C is ours
    )


def execute(
    runs: Sequence[PlannedRun],
    out: Path,
    executor: "Processes | RayTasks",
    *,
    references: Sequence[PlannedReference] = (),
    workers: int = 1,
    retry_failed: bool = False,
    command: Sequence[str] = (),
) -> bool:
    """Finish all runs that are not done yet, in a results folder; `executor` is closed.

    Args:
        runs: the runs of a plan; with `retry_failed`, failed ones go on from their checkpoints.
        out: the results folder, new or of an earlier version of the plan.
        executor: where they are executed.
        references: the plan's reference policies.
        workers: processes that generate demonstrations.
        retry_failed: see `runs`.
        command: the words of the command that does this, but for the folder, for `magical status`.

    Returns:
        Whether Ctrl-C or SIGTERM interrupted it; they leave checkpoints.

    Raises:
        RunFolderError: the folder cannot be used for these runs, or no space is left.
        ClusterError: the Ray cluster is lost.
        DatasetError, DemonstrationsError: no demonstrations to learn from, or too few.
    """
    out = out.absolute()
    with closing(executor), Interrupts() as stop, opened(out):
        states = {run: planned_state(run, out) for run in runs}
        again = (None, FAILED) if retry_failed else (None,)
        waiting = [run for run in runs if states[run] in again]
        work: dict[Planned, Path] = {run: out / RUNS / run.folder for run in waiting}
        work |= {each: out / REFERENCES / each.folder for each in references}
        listed = [asdict(run.listed()) for run in runs]
        names = [each.folder for each in references]
        write_json(out / PLAN, {"runs": listed, "references": names, "command": list(command)})

        def go_on(_: int) -> None:
            if stop.seen:  # demonstrations that are complete are kept
                raise InterruptedError

        with suppress(InterruptedError):
            demos = prepare_demonstrations(waiting, out, workers, go_on)
            if work:
                _say(f"{len(work)} to do; magical status {out} shows the progress")
            _finish_all(work, demos, executor, stop)
        return stop.seen


def _finish_all(
    work: Mapping[Planned, Path],
    demos: Path | None,
    executor: "Processes | RayTasks",
    stop: Interrupts,
) -> None:
    ended: SimpleQueue[Future[None]] = SimpleQueue()
    started = {executor.submit(each, folder, demos): each for each, folder in work.items()}
    for future in started:
        future.add_done_callback(ended.put)
    left, stopping = len(started), False
    while left:
        if stop.seen and not stopping:  # a second SIGTERM would end a run without a checkpoint
            stopping = True
            executor.stop()
        with suppress(Empty):
            future = ended.get(timeout=POLL)
            left -= 1
            error = None if stop.seen else future.exception()
            if line := _ending(started[future], work[started[future]], error):
                count = f"{len(started) - left} of {len(started)}"
                _say(f"{line} ({count})")


def _say(line: str) -> None:
    print(for_terminal(line), file=sys.stderr, flush=True)


def _ending(work: Planned, folder: Path, error: BaseException | None) -> str:
    """How a run or the evaluation of a reference policy has ended; empty if it was interrupted."""
    if isinstance(error, ClusterError) or is_out_of_space(error):
        raise error  # type: ignore[misc]  # everything else would fail, too
    if isinstance(work, PlannedReference):
        return f"{FAILED}: {work}: {error}" if error else f"{DONE}: {work}"
    if error:
        write_failure(work, folder, error)
    record = read_result(folder)
    why = f": {record['error']}" if "error" in record else ""
    return f"{record['state']}: {work}{why}" if record else ""


@contextmanager
def opened(out: Path) -> Iterator[None]:
    """Hold the lock of a results folder, which is created if missing.

    Raises `RunFolderError`: the folder holds other files; another process executes a plan in it; no
    space is left on the device.
    """
    if out.exists() and not (out / PLAN).exists():
        known = {RUNS, REFERENCES, DEMOS}  # of a plan that was killed
        if not out.is_dir() or {path.name for path in out.glob("[!.]*")} - known:
            raise RunFolderError(
                f"{out}: expected an empty folder, found other things; choose another"
            )
    with owned(out, RunFolderError, "runs a plan in it"):
        yield


def planned_state(run: PlannedRun, out: Path) -> str | None:
    """`done`, `failed`, or `None` for a run that has not been finished in a results folder.

    Raises `RunFolderError` if its folder holds a run with other settings, or a damaged record.
    """
    folder = out / RUNS / run.folder
    result, different = read_result(folder), ""
    if result:
        wanted, found = run.settings(), result["settings"]
        # An option that is newer than the record, as of a study, cannot differ.
        config = {name: found["config"].get(name, x) for name, x in wanted["config"].items()}
        different = differences(_flat(wanted), _flat({**found, "config": config}))
    elif is_run(folder):
        different = differences(run.config.to_dict(), read_json(folder / CONFIG))
    if different:
        raise RunFolderError(
            f"{folder} holds a run with other settings: {different}; choose another folder "
            "(--out), or remove this one to do the run again"
        )
    return result.get("state")


def _flat(settings: Mapping[str, Any]) -> dict[str, Any]:
    config = settings["config"]  # `differences` ignores its demos, which are a path elsewhere
    return {**settings, **config, "config": None, "demonstrations": config.get("demos")}


def prepare_demonstrations(
    runs: Sequence[PlannedRun],
    out: Path,
    workers: int = 1,
    progress: Callable[[int], None] = lambda _: None,
) -> Path | None:
    """The dataset that the runs of a plan learn from; `None` if they need no demonstrations.

    Missing ones are generated in the results folder `out`, by `workers` processes; they are the
    same whether or not an earlier call was interrupted. `progress` is called after each.

    Raises:
        DatasetError: the user's dataset is missing or damaged, or too few attempts succeed.
        DemonstrationsError: it has too few demonstrations for a run.
    """
    counts: dict[str, int] = {}
    for run in runs:
        if isinstance(wanted := run.config, DemonstrationConfig):
            counts |= {task: max(wanted.num_demos, counts.get(task, 0)) for task in run.tasks}
            source, given = run.source, Path(wanted.demos).absolute()  # all have the plan's
    if not counts:
        return None
    if source.dataset:
        alone = source.expert_demos is None
        _require_enough(Dataset.open(given), counts if alone else dict.fromkeys(counts, 1))
    if source.expert_demos is None:
        return given
    parts = (f"{name.replace('_', '-')}-{value:g}" for name, value in source.generation.items())
    folder = out / DEMOS / "-".join([f"expert-{source.expert_demos}", *parts])
    settings: dict[str, Any] = {**source.generation, "workers": workers, "progress": progress}
    for task in counts:
        generate(EnvId(task, "Demo"), source.expert_demos, folder, **settings)
    if not source.dataset:
        return folder
    pooled = out / DEMOS / f"dataset-and-{folder.name}"
    _pool([Dataset.open(given), Dataset.open(folder)], counts, pooled)
    _require_enough(Dataset.open(pooled), counts)
    return pooled


def _pool(datasets: Sequence[Dataset], tasks: Iterable[str], folder: Path) -> None:
    """Copy each task's demonstrations from the datasets, one after another, into one dataset.

    Within a task the order is always the same, and so is what a run samples.
    """
    writer = DatasetWriter(folder)
    # A process that was killed has left some.
    copied = Counter(entry.task for entry in Dataset.open(folder).entries)
    for task in tasks:
        all_of_task = chain.from_iterable(d.filter(task=task, variant="Demo") for d in datasets)
        for trajectory in islice(all_of_task, copied[task], None):
            writer.append(trajectory)


def _require_enough(dataset: Dataset, counts: Mapping[str, int]) -> None:
    found = Counter(entry.task for entry in dataset.entries if entry.variant == "Demo")
    for task, number in counts.items():
        if found[task] < number:
            raise DemonstrationsError(
                f"{dataset.path}: expected at least {number} demonstrations of {task} (Demo), "
                f"found {found[task]}; add demonstrations, give another folder (--demos), or lower "
                "num_demos in the plan"
            )
