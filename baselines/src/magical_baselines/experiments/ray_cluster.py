"""Runs as tasks of a Ray cluster (docs/experiments.md); needs the extra `ray`."""

import io
import shutil
import signal
import socket
import tarfile
import tempfile
import threading
import warnings
from collections.abc import Iterator, Sequence
from concurrent.futures import Future
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import ray
from ray.exceptions import (
    OutOfMemoryError,
    RayError,
    RayTaskError,
    TaskCancelledError,
    WorkerCrashedError,
)

from magical.errors import ClusterError, ResultsError
from magical.files import LOCK, make_folder
from magical.messages import printable
from magical.runs.folder import CHECKPOINT
from magical.runs.plan import RESULT
from magical.tasks import load_tasks
from magical_baselines.experiments.one_run import finish, modules_of_run
from magical_baselines.experiments.plan import PlannedRun
from magical_baselines.experiments.results import DONE, Outcome, Results, read_experiment
from magical_baselines.training import SIGNALS

RETRIES = 3  # after a node, or a process on it, has died
MAX_ERROR = 500  # characters of Ray's own messages
TIMEOUT = 10.0  # seconds to reach a cluster's port

Returned = tuple[Outcome, bytes | None]  # with the run's packed folder, if it must be sent


class RayExecutor:
    """Finishes runs as Ray tasks, each of which reserves its threads and a share of a GPU.

    If a node shares the results folder, its runs write there, and a restarted run resumes from its
    checkpoint. Otherwise Ray sends the demonstrations to the node and the folder of a finished run
    back.
    """

    def __init__(
        self,
        runs: Sequence[PlannedRun],
        results: Results,
        address: str | None = None,
        workers: int | None = None,
        gpus: float = 0.0,
    ) -> None:
        """Connect to the cluster at `address`, or as `Resources` says; may raise `ClusterError`."""
        self._threads = max((run.config.threads for run in runs), default=1)
        self._gpus = gpus
        self._results = results
        _connect(address, workers and workers * self._threads)
        on_cpu = [run for run in runs if run.config.device == "auto"]
        if not gpus and on_cpu and (found := ray.cluster_resources().get("GPU", 0)):
            message = f"--gpus: Ray reserves no GPU for a run, but the cluster has {found:g}: "
            message += "runs with device auto are on CPUs; --gpus 1 reserves one for each run"
            warnings.warn(message, stacklevel=2)
        self._remote = ray.remote(_finish)
        self._packed: dict[Path, Any] = {}  # datasets, as object references
        self._tasks: dict[Future[Returned], Any] = {}  # the object references

    def slots(self) -> int:
        """How many runs the current nodes can have in progress at a time."""
        with _cluster_needed():
            resources = ray.cluster_resources()
        slots = int(resources.get("CPU", 0) // self._threads)
        if self._gpus:
            slots = min(slots, int(resources.get("GPU", 0) / self._gpus))
        return max(1, slots)

    def start(self, run: PlannedRun, demos: Path | None) -> Future[Outcome]:
        """Start a run, which learns from the dataset `demos`."""
        task = self._remote.options(
            name=run.folder,
            num_cpus=run.config.threads,
            num_gpus=self._gpus,
            max_retries=RETRIES,
        )
        folder = self._results.folder(run)
        with _cluster_needed():
            if demos and demos not in self._packed:
                self._packed[demos] = ray.put(pack(demos))
            # References in a list are not fetched before they are needed.
            dataset = (str(demos), [self._packed[demos]]) if demos else None
            reference = task.remote(
                run, str(folder), self._results.id, dataset, modules_of_run(run)
            )
            ended: Future[Returned] = reference.future()
        self._tasks[ended] = reference
        outcome: Future[Outcome] = Future()
        ended.add_done_callback(lambda _: self._settle(ended, folder, outcome))
        return outcome

    def stop(self) -> None:
        """Have the runs in progress save a checkpoint and end."""
        for reference in list(self._tasks.values()):
            ray.cancel(reference, force=False)

    def close(self) -> None:
        """Leave the cluster; one that was started here is shut down."""
        ray.shutdown()

    def _settle(self, ended: Future[Returned], folder: Path, outcome: Future[Outcome]) -> None:
        """Store a run's folder if it came back through Ray, then pass its outcome on."""
        self._tasks.pop(ended, None)
        try:
            result, packed = ended.result()
            if packed is not None:
                begun_here = result.state != DONE and (folder / CHECKPOINT).is_file()
                unpack(packed, folder, RESULT if begun_here else None)
            outcome.set_result(result)
        except (RayTaskError, TaskCancelledError, WorkerCrashedError, OutOfMemoryError) as error:
            outcome.set_exception(error)  # caused by the run itself, RETRIES times
        except RayError as error:
            # If this machine's node was lost, Ray ends this process next, so this line is its last.
            why = (
                f"{printable(str(error), MAX_ERROR)} The run is retried, now or by the same command"
            )
            outcome.set_result(Outcome("lost", error=why))
        except Exception as error:
            outcome.set_exception(error)


@contextmanager
def _cluster_needed() -> Iterator[None]:
    """Raise the errors of a lost cluster as `ClusterError`."""
    try:
        yield
    except (RayError, ConnectionError) as error:
        raise ClusterError(
            f"the Ray cluster is gone: {printable(str(error), MAX_ERROR)}; run the same command "
            "again to continue"
        ) from error


def pack(folder: Path) -> bytes:
    """A folder as the bytes of an uncompressed tar file, without locks."""
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w") as archive:
        archive.add(folder, ".", filter=lambda item: None if item.name.endswith(LOCK) else item)
    return buffer.getvalue()


def unpack(packed: bytes, folder: Path, only: str | None = None) -> None:
    """Write what `pack` has packed; an existing folder is replaced.

    With `only`, the name of a file in it, just that file is written or replaced.
    """
    make_folder(folder.parent)
    # Under an unpredictable name: a link may be planted under a known one.
    with tempfile.TemporaryDirectory(".part", f".{folder.name}.", folder.parent) as temporary:
        new = Path(temporary) / "new"
        with tarfile.open(fileobj=io.BytesIO(packed)) as archive:
            archive.extractall(new, filter="data")
        if only is None:
            shutil.rmtree(folder, ignore_errors=True)
            new.replace(folder)
        else:
            (new / only).replace(folder / only)


def _connect(address: str | None, cores: int | None) -> None:
    """Connect to a cluster, or start one on this machine if `cores` are given or none is found."""
    if address and not _answers(address):
        raise ClusterError(_unreachable(address, f"no answer within {TIMEOUT:g} s"))
    with _own_signal_handlers():
        if address is None and cores is None:
            with suppress(ConnectionError):
                ray.init(address="auto", log_to_driver=False)
                return
        num_cpus = None if address else cores
        try:
            ray.init(address=address or "local", num_cpus=num_cpus, log_to_driver=False)
        except (ConnectionError, RuntimeError, ValueError, TimeoutError) as error:
            reason = str(error)[:MAX_ERROR]
            raise ClusterError(_unreachable(address or "this machine", reason)) from error


@contextmanager
def _own_signal_handlers() -> Iterator[None]:
    """A context that undoes changes of signal handlers: `ray.init` replaces SIGTERM's."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.getsignal(number) for number in SIGNALS}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _unreachable(address: str, reason: str) -> str:
    return (
        f"the Ray cluster at {address} cannot be reached: {reason}; start one with "
        "`ray start --head`, and give the address that it prints"
    )


def _answers(address: str) -> bool:
    """Whether something listens at `host:port` or `ray://host:port`; true for other addresses."""
    host, colon, port = address.removeprefix("ray://").rpartition(":")
    if not colon or not port.isdigit():
        return True
    try:
        socket.create_connection((host.strip("[]"), int(port)), TIMEOUT).close()
    except OSError:
        return False
    return True


def _finish(
    run: PlannedRun,
    folder: str,
    identity: str,
    demos: tuple[str, list[Any]] | None,
    modules: Sequence[str],
) -> Returned:
    """A run's task on a node of the cluster."""
    load_tasks(modules)
    shared = Path(folder)
    if _is_shared(shared, identity):
        return finish(run, shared, None if demos is None else Path(demos[0])), None
    with tempfile.TemporaryDirectory(prefix="magical-") as name:
        own = Path(name) / "run"
        dataset = None
        if demos is not None:
            dataset = Path(name) / "demos"
            unpack(ray.get(demos[1][0]), dataset)
        outcome = finish(run, own, dataset)
        complete = (own / RESULT).is_file()
        return outcome, pack(own) if complete else None


def _is_shared(folder: Path, identity: str) -> bool:
    """Whether this node sees the results folder itself, not one of its own at the same path."""
    try:
        return read_experiment(folder.parents[1]).id == identity
    except ResultsError:
        return False
