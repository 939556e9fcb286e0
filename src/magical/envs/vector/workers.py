"""The parent's side of worker processes: how they are started, called and ended."""

import os
import select
import subprocess
import sys
import time
import weakref
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from types import ModuleType
from typing import Any, NoReturn

import magical.tasks
from magical.envs.vector.buffers import SharedMemory
from magical.envs.vector.sub_envs import Seeds, VectorSpec
from magical.envs.vector.worker import CALL, ERROR, STEP, encode, receive, send
from magical.errors import InvalidTaskError, WorkerDiedError, WorkerTimeoutError
from magical.processes import Child, rebuild
from magical.scene.scene import Scene
from magical.tasks import Task

_GRACE_PERIOD = 2.0  # seconds that workers have to end by themselves
Started = list[tuple[int, Scene | Mapping[str, Any]]]


class RemoteSubEnvs:
    """All sub-environments of a vector environment, spread over worker processes.

    It has the methods of `SubEnvs`. The processes end with `close`, with this object's life, or
    with this process, whichever comes first.

    Args:
        spec: what the vector environment consists of.
        workers: the number of processes, at most one for each sub-environment.
        memory: what the buffers lie in.
        plugins: modules that workers import to register tasks.
        timeout: seconds that a call may take, but not the start; None for no limit.
    """

    def __init__(
        self,
        spec: VectorSpec,
        workers: int,
        memory: SharedMemory,
        plugins: Sequence[str],
        timeout: float | None = None,
    ) -> None:
        self._timeout = timeout
        self._workers: list[_Worker] = []
        self.close = weakref.finalize(self, _end, self._workers, os.getpid())
        setup = {"spec": spec.to_dict(), "handle": memory.handle, "plugins": list(plugins)}
        try:
            for rows in split(len(spec.env_ids), workers):
                names = [spec.env_ids[row] for row in rows]
                self._workers.append(_Worker(len(self._workers), rows, names, memory.inherited))
                self._workers[-1].send(encode(CALL, {**setup, "rows": list(rows)}))
            self._replies(self._workers, None)
        except BaseException:
            self.close()
            raise
        finally:
            memory.release_handle()

    @property
    def process_ids(self) -> list[int]:
        """The workers' process ids."""
        return [worker.child.process.pid for worker in self._workers]

    def step(self) -> Started:
        """See `SubEnvs.step`."""
        replies = self._exchange([(worker, STEP) for worker in self._workers])
        return [started for reply in replies if reply for started in reply]

    def reset(self, seeds: Seeds, options: Mapping[str, Any] | None) -> Started:
        """See `SubEnvs.reset`."""
        messages = []
        for worker in self._workers:
            share = [(row, seed) for row, seed in seeds if row in worker.rows]
            if share:
                message = encode(CALL, {"call": "reset", "args": [share, options]})
                messages.append((worker, message))
        return [started for reply in self._exchange(messages) for started in reply]

    def get_state(self, row: int) -> dict[str, Any]:
        """See `SubEnvs.get_state`."""
        state: dict[str, Any] = self._call(row, "get_state")
        return state

    def set_state(self, row: int, state: Mapping[str, Any]) -> Started:
        """See `SubEnvs.set_state`."""
        started: Started = self._call(row, "set_state", dict(state))
        return started

    def _call(self, row: int, name: str, *args: Any) -> Any:
        """Call a method of the `SubEnvs` that sub-environment `row` belongs to."""
        message = encode(CALL, {"call": name, "args": [row, *args]})
        (worker,) = (worker for worker in self._workers if row in worker.rows)
        return self._exchange([(worker, message)])[0]

    def _exchange(self, messages: "Sequence[tuple[_Worker, bytes]]") -> list[Any]:
        """Send requests and wait for the replies, within the timeout."""
        deadline = None if self._timeout is None else time.monotonic() + self._timeout
        for worker, message in messages:
            try:
                worker.send(message, deadline)
            except BrokenPipeError:
                self._raise_died(worker)
            except TimeoutError:
                self._raise_timeout([worker])
        return self._replies([worker for worker, _ in messages], deadline)

    def _replies(self, workers: "Sequence[_Worker]", deadline: float | None) -> list[Any]:
        """Every worker's reply, or the first error among them."""
        replies = []
        for worker in workers:
            try:
                replies.append(worker.receive(deadline))
            except EOFError:
                self._raise_died(worker)
            except TimeoutError:
                self._raise_timeout([w for w in workers[len(replies) :] if not w.has_replied()])
        for kind, data in replies:
            if kind == ERROR:
                raise rebuild(data)
        return [data for _, data in replies]

    def _raise_died(self, worker: "_Worker") -> NoReturn:
        end = worker.child.describe_end()
        self.close()
        raise WorkerDiedError(
            f"{worker} {end}; all other workers were ended; make another vector environment"
        )

    def _raise_timeout(self, late: "Sequence[_Worker]") -> NoReturn:
        for worker in late:
            worker.child.process.kill()
        self.close()
        raise WorkerTimeoutError(
            f"expected every worker to finish within {self._timeout:g} s, found at work: "
            f"{'; '.join(map(str, late))}; all workers were ended; make another vector "
            "environment, with a longer timeout if a call may take longer"
        )


class _Worker:
    """One worker process and the two pipes to it."""

    def __init__(
        self, index: int, rows: range, env_ids: Sequence[str], inherited: tuple[int, ...]
    ) -> None:
        self.index = index
        self.rows = rows
        self.env_ids = env_ids
        self.child = Child("magical.envs.vector.worker", inherited)
        self._requests = self.child.requests.fileno()
        self._replies = self.child.replies.fileno()

    def __str__(self) -> str:
        names = ", ".join(dict.fromkeys(self.env_ids))
        return f"worker {self.index} (environments {self.rows[0]} to {self.rows[-1]}: {names})"

    def send(self, message: bytes, deadline: float | None = None) -> None:
        """Send a request; see `worker.send`."""
        send(self._requests, message, deadline)

    def receive(self, deadline: float | None = None) -> tuple[bytes, Any]:
        """Wait for the reply; see `worker.receive`."""
        return receive(self._replies, deadline)

    def has_replied(self) -> bool:
        """Whether a reply, or the end of the process, can be read."""
        poll = select.poll()
        poll.register(self._replies, select.POLLIN)
        return bool(poll.poll(0))


def split(count: int, workers: int) -> Iterator[range]:
    """Rows of `count` sub-environments for each of at most `workers` workers, divided evenly."""
    workers = min(workers, count)
    for i in range(workers):
        yield range(count * i // workers, count * (i + 1) // workers)


def defining_modules(tasks: Sequence[Task]) -> list[str]:
    """The modules that a new process must import to have tasks from outside the package.

    Raises `InvalidTaskError` for a task that no importable module holds.
    """
    own = [module for module in vars(magical.tasks).values() if isinstance(module, ModuleType)]
    foreign = [task for task in tasks if not any(_holds(module, task) for module in own)]
    return sorted({_defining_module(task) for task in foreign})


def _defining_module(task: Task) -> str:
    for name, module in list(sys.modules.items()):
        if name != "__main__" and _holds(module, task):
            return name
    raise InvalidTaskError(
        f"task {task.name}: workers import tasks by themselves, and no importable module holds "
        "this one (the main script is never imported); move it to a module and give that "
        "module's name in plugins=[...], or use workers=0 (for experts, workers=1)"
    )


def _holds(module: ModuleType, task: Task) -> bool:
    return any(value is task for value in list(getattr(module, "__dict__", {}).values()))


def _end(workers: list[_Worker], owner: int) -> None:
    """End workers and wait until they have; kill those that take too long."""
    if os.getpid() != owner:  # a fork of the process they belong to
        return
    for worker in workers:
        with suppress(OSError):  # a request that could not be written
            worker.child.requests.close()
    deadline = time.monotonic() + _GRACE_PERIOD
    for worker in workers:
        with suppress(subprocess.TimeoutExpired):
            worker.child.process.wait(max(0.0, deadline - time.monotonic()))
        worker.child.close()
