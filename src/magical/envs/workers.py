"""The parent's side of worker processes: starting, talking to, and ending them."""

import os
import subprocess
import sys
import time
import weakref
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from types import ModuleType
from typing import Any

import magical.tasks
from magical.envs.batch import BatchSpec, Seeds
from magical.envs.block import SharedMemory
from magical.envs.worker import CALL, ERROR, STEP, encode, receive, send
from magical.errors import InvalidTaskError, WorkerDiedError
from magical.processes import Child, rebuild
from magical.scene.scene import Scene
from magical.tasks import Task

_PATIENCE = 2.0  # seconds that workers are given to end by themselves
Started = list[tuple[int, Scene | Mapping[str, Any]]]


class RemoteBatch:
    """All worlds of a vector environment, spread over worker processes.

    It is asked the same things as `Batch`. The processes end with `close`, with this object's
    life, or with this process, whichever comes first.
    """

    def __init__(
        self, spec: BatchSpec, workers: int, memory: SharedMemory, plugins: Sequence[str]
    ) -> None:
        self._workers: list[_Worker] = []
        self.close = weakref.finalize(self, _end, self._workers, os.getpid())
        setup = {"spec": spec.to_dict(), "handle": memory.handle, "plugins": list(plugins)}
        try:
            for rows in split(len(spec.env_ids), workers):
                names = [spec.env_ids[row] for row in rows]
                self._workers.append(_Worker(len(self._workers), rows, names, memory.inherited))
                self._workers[-1].ask(encode(CALL, {**setup, "rows": list(rows)}))
            self._answers(self._workers)
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
        """See `Batch.step`."""
        for worker in self._workers:
            self._ask(worker, STEP)
        answers = self._answers(self._workers)
        return [started for answer in answers if answer for started in answer]

    def reset(self, seeds: Seeds, options: Mapping[str, Any] | None) -> Started:
        """See `Batch.reset`."""
        messages = []
        for worker in self._workers:
            share = [(row, seed) for row, seed in seeds if row in worker.rows]
            if share:
                message = encode(CALL, {"call": "reset", "args": [share, options]})
                messages.append((worker, message))
        for worker, message in messages:
            self._ask(worker, message)
        answers = self._answers([worker for worker, _ in messages])
        return [started for answer in answers for started in answer]

    def get_state(self, row: int) -> dict[str, Any]:
        """See `Batch.get_state`."""
        state: dict[str, Any] = self._call(self._owner(row), "get_state", row)[0]
        return state

    def set_state(self, row: int, state: Mapping[str, Any]) -> Started:
        """See `Batch.set_state`."""
        started: Started = self._call(self._owner(row), "set_state", row, dict(state))[0]
        return started

    def time_physics(self, on: bool) -> float:
        """See `Batch.time_physics`; the sum over workers."""
        return sum(answer or 0.0 for answer in self._call(self._workers, "time_physics", on))

    def _owner(self, row: int) -> "list[_Worker]":
        return [worker for worker in self._workers if row in worker.rows]

    def _call(self, workers: "list[_Worker]", call: str, *args: Any) -> list[Any]:
        message = encode(CALL, {"call": call, "args": args})
        for worker in workers:
            self._ask(worker, message)
        return self._answers(workers)

    def _ask(self, worker: "_Worker", message: bytes) -> None:
        try:
            worker.ask(message)
        except BrokenPipeError:
            self._mourn(worker)

    def _answers(self, workers: "list[_Worker]") -> list[Any]:
        """Every worker's answer, or the first error among them."""
        answers = []
        for worker in workers:
            try:
                answers.append(worker.answer())
            except EOFError:
                self._mourn(worker)
        for kind, data in answers:
            if kind == ERROR:
                raise rebuild(data)
        return [data for _, data in answers]

    def _mourn(self, worker: "_Worker") -> None:
        end = worker.child.describe_end()
        self.close()
        raise WorkerDiedError(
            f"worker {worker.index} (environments {worker.rows[0]} to {worker.rows[-1]}: "
            f"{', '.join(dict.fromkeys(worker.env_ids))}) {end}; all other workers were ended; "
            "make the vector environment anew"
        )


class _Worker:
    """One worker process and the two pipes to it."""

    def __init__(
        self, index: int, rows: range, env_ids: Sequence[str], inherited: tuple[int, ...]
    ) -> None:
        self.index = index
        self.rows = rows
        self.env_ids = env_ids
        self.child = Child("magical.envs.worker", inherited)
        self._requests = self.child.requests.fileno()
        self._replies = self.child.replies.fileno()

    def ask(self, message: bytes) -> None:
        """Send a request."""
        send(self._requests, message)

    def answer(self) -> tuple[bytes, Any]:
        """Wait for the reply; raises `EOFError` if the worker has ended."""
        return receive(self._replies)


def split(count: int, workers: int) -> Iterator[range]:
    """Shares of `count` worlds for at most `workers` workers, in order, as even as can be."""
    workers = min(workers, count)
    for i in range(workers):
        yield range(count * i // workers, count * (i + 1) // workers)


def defining_modules(tasks: Sequence[Task]) -> list[str]:
    """The modules from which a new process learns of tasks from outside the package.

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
        worker.child.close_pipes()
    deadline = time.monotonic() + _PATIENCE
    for worker in workers:
        with suppress(subprocess.TimeoutExpired):
            worker.child.process.wait(max(0.0, deadline - time.monotonic()))
        worker.child.close()
