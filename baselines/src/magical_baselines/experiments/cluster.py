"""Runs as tasks of a Ray cluster (docs/experiments.md); needs the extra `ray`."""

import io
import shutil
import tarfile
import tempfile
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import ray
from ray import exceptions

from magical.errors import ClusterError
from magical.messages import printable
from magical.runs import RESULT
from magical.tasks import load_tasks
from magical_baselines.experiments.one_run import Planned, finish, modules_needed
from magical_baselines.experiments.plan import PlannedRun

RETRIES = 3  # after a node, or a process on it, has died
# Errors that a run causes itself, not the cluster.
OF_THE_RUN = exceptions.RayTaskError, exceptions.WorkerCrashedError, exceptions.OutOfMemoryError
MAX_ERROR = 500  # characters of Ray's own messages


class RayTasks:
    """Runs as Ray tasks; each reserves its threads and a share of a GPU.

    A node that shares the results folder writes there, and a run that is restarted resumes.
    Otherwise Ray sends the demonstrations to the node, and back the folder of a finished run.
    """

    def __init__(self, out: Path, address: str | None, cores: int | None, gpus: float) -> None:
        """Connect to a cluster; without an address to this machine's, or start one with `cores`."""
        try:
            if address:
                ray.init(address=address, log_to_driver=False)
            elif cores or not _connected():
                ray.init(address="local", num_cpus=cores, log_to_driver=False)
        except (ConnectionError, RuntimeError, ValueError, TimeoutError) as error:
            why = printable(str(error), MAX_ERROR)
            then = "start one with `ray start --head`, and give the address that it prints"
            raise ClusterError(f"{address or 'Ray'} cannot be reached: {why}; {then}") from error
        out.mkdir(parents=True, exist_ok=True)
        # A node that sees this sees the folder itself, not one of its own at the same path.
        self.marker = Path(tempfile.mkdtemp(".ray", ".", out.absolute()))
        self._gpus, self._task = gpus, ray.remote(_finish)
        self._packed: dict[Path, Any] = {}  # datasets, as object references
        self._started: list[Any] = []

    def submit(self, work: Planned, folder: Path, demos: Path | None) -> "Future[None]":
        """Call `one_run.finish` on a node; `ClusterError` in the future if the cluster is lost."""
        if demos and demos not in self._packed:
            self._packed[demos] = ray.put(pack(demos))
        cores = work.config.threads if isinstance(work, PlannedRun) else 1
        options = {"num_cpus": cores, "num_gpus": self._gpus, "max_retries": RETRIES}
        task = self._task.options(name=folder.name, **options)
        packed = [self._packed[demos]] if demos else []  # in a list it is fetched only if needed
        modules = modules_needed(work)
        self._started.append(task.remote(work, folder, demos, packed, self.marker, modules))
        settled: Future[None] = Future()
        self._started[-1].future().add_done_callback(lambda ended: _settle(ended, folder, settled))
        return settled

    def stop(self) -> None:
        """Start nothing more, and have runs in progress save a checkpoint and end."""
        while self._started:
            ray.cancel(self._started.pop(), force=False)

    def close(self) -> None:
        """Leave the cluster; one that was started here is shut down."""
        ray.shutdown()
        shutil.rmtree(self.marker, ignore_errors=True)


def _connected() -> bool:
    """Whether this machine belongs to a cluster, which this process has joined."""
    try:
        ray.init(address="auto", log_to_driver=False)
    except ConnectionError:
        return False
    return True


def _settle(ended: "Future[bytes | None]", folder: Path, settled: "Future[None]") -> None:
    """Store a folder that came back through Ray, then pass the outcome on."""
    try:
        if packed := ended.result():
            unpack(packed, folder)
        settled.set_result(None)
    except Exception as error:
        if isinstance(error, exceptions.RayError) and not isinstance(error, OF_THE_RUN):
            again = "run the same command again to continue"
            error = ClusterError(f"{printable(str(error), MAX_ERROR)}; {again}")
        settled.set_exception(error)


def _finish(
    work: Planned, folder: Path, demos: Path | None, packed: list[Any], marker: Path, modules: Any
) -> bytes | None:
    """`finish` on a node of the cluster; returns the folder unless it is shared."""
    load_tasks(modules)
    if marker.exists():
        finish(work, folder, demos)
        return None
    with tempfile.TemporaryDirectory(prefix="magical-") as name:
        own = Path(name, "runs", folder.name)
        if demos:
            unpack(ray.get(packed[0]), Path(name, "demos"))
        finish(work, own, Path(name, "demos") if demos else None)
        complete = (own / RESULT).exists() or not isinstance(work, PlannedRun)
        return pack(own) if complete else None


def pack(folder: Path) -> bytes:
    """A folder as the bytes of an uncompressed tar file."""
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w") as archive:
        archive.add(folder, ".", filter=lambda item: None if item.name.endswith(".lock") else item)
    return buffer.getvalue()


def unpack(packed: bytes, folder: Path) -> None:
    """Write what `pack` has packed; an existing folder is replaced."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    temporary = Path(tempfile.mkdtemp(".part", f".{folder.name}.", folder.parent))
    with tarfile.open(fileobj=io.BytesIO(packed)) as archive:
        archive.extractall(temporary, filter="data")
    shutil.rmtree(folder, ignore_errors=True)
    temporary.rename(folder)
