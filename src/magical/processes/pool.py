"""A function mapped over items in several processes: the one pool for finite work."""

import atexit
import os
import pickle
from collections import deque
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from concurrent.futures import Future
from contextlib import closing
from functools import partial
from itertools import cycle, islice
from queue import SimpleQueue
from threading import Lock, Thread
from typing import IO, Any, TypeVar

from magical.errors import WorkerDiedError
from magical.processes.channel import serve
from magical.processes.children import Child

Item = TypeVar("Item")
Result = TypeVar("Result")


def available_cores() -> int:
    """The number of processor cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def checked_workers(workers: int | None) -> int:
    """A number of processes, by default one for each core; raises `ValueError` below 0."""
    if workers is None:
        return available_cores()
    if workers < 0:
        raise ValueError(f"workers: expected at least 0, or None, found {workers}")
    return workers


def map_in_processes(
    work: Callable[[Item], Result], items: Iterable[Item], workers: int
) -> Generator[Result, None, None]:
    """Yield `work(item)` for each item, in the items' order, computed in child processes.

    Only a few results wait at any time, so items may be infinite; closing the generator kills the
    processes. They end with this process too, however it ends, and leave nothing behind. A process
    that dies costs the item it was working on and is replaced. The main script is never imported,
    so it needs no `if __name__ == "__main__":`, and `work` must be in an importable module.

    Args:
        work: a function that pickle can name, such as one at the top of a module, or a partial.
        items: items that can be pickled.
        workers: the number of processes; with 1 or less everything is done in this process.

    Raises:
        WorkerDiedError: a process exited or was killed.
        Exception: what `work` raises. In a child, an exception that is neither built in nor from
            `magical.errors` becomes a `WorkerError`; the cause is the child's traceback.
    """
    with closing(_calls(work, items, workers)) as calls:
        for call in calls:
            yield call()


def outcomes_in_processes(
    work: Callable[[Item], Result], items: Iterable[Item], workers: int
) -> Generator[Result | Exception, None, None]:
    """As `map_in_processes`, but an exception is yielded as the item's result."""
    with closing(_calls(work, items, workers)) as calls:
        for call in calls:
            outcome: Result | Exception
            try:
                outcome = call()
            except Exception as error:
                outcome = error
            yield outcome


def _calls(
    work: Callable[[Item], Result], items: Iterable[Item], workers: int
) -> Generator[Callable[[], Result], None, None]:
    """For each item, a function that waits for `work(item)`, or computes it in this process."""
    if workers <= 1:
        for item in items:
            yield partial(work, item)
        return
    with closing(ProcessPool(workers)) as pool:
        waiting: deque[Future[Result]] = deque()
        for item in items:
            waiting.append(pool.submit(work, item))
            if len(waiting) > 2 * workers:
                yield waiting.popleft().result
        for future in waiting:
            yield future.result


class ProcessPool:
    """Child processes that compute one task after another; tasks are submitted individually.

    `map_in_processes` is simpler if results are wanted in the items' order. The children differ in
    the environment variables `environs`, which are given to them by turns.
    """

    def __init__(self, count: int, environs: Sequence[Mapping[str, str]] = ({},)) -> None:
        self._tasks: SimpleQueue[tuple[bytes, Future[Any]] | None] = SimpleQueue()
        self._children: list[Child] = []
        self._lock = Lock()  # held while a task is added, or a child is started or removed
        self._closed = False
        self._owner = os.getpid()
        atexit.register(self.close)  # while the threads can still run
        # Each has its own child, from its first task on.
        given = islice(cycle(environs), count)
        self._threads = [
            Thread(target=self._serve, args=(environ,), daemon=True) for environ in given
        ]
        for thread in self._threads:
            thread.start()

    def submit(self, work: Callable[[Item], Result], item: Item) -> "Future[Result]":
        """Compute `work(item)` in a child as soon as one is idle.

        See `map_in_processes` for what `work` may be and which exceptions the result may have; in a
        closed pool it is a `WorkerDiedError`.
        """
        result: Future[Result] = Future()
        message = pickle.dumps((work, item))
        with self._lock:
            if self._closed:
                result.set_exception(_closed_error())
            else:
                self._tasks.put((message, result))
        return result

    def terminate(self) -> None:
        """Send SIGTERM to all children, and start no more tasks.

        Work that handles the signal can finish what it is doing. Other tasks fail with
        `WorkerDiedError`. (Windows has no such signal: there every child ends at once.)
        """
        with self._lock:
            self._closed = True
            for child in self._children:
                child.process.terminate()

    def close(self) -> None:
        """End all children at once, whatever they are doing."""
        if os.getpid() != self._owner:  # a fork of the process that they belong to
            return
        atexit.unregister(self.close)
        with self._lock:
            self._closed = True
            for child in self._children:
                child.process.kill()
        for _ in self._threads:
            self._tasks.put(None)
        for thread in self._threads:
            thread.join()

    def _serve(self, environ: Mapping[str, str]) -> None:
        """Have a child compute one task after another; a child that dies is replaced."""
        child: Child | None = None
        while task := self._tasks.get():
            message, result = task
            if not result.set_running_or_notify_cancel():
                continue
            try:
                child = self._open_child(child, environ)
                child.send(message)
                succeeded, value = child.receive()
            except WorkerDiedError as error:
                self._remove(child)
                child = None
                succeeded, value = False, error
            except BaseException as error:  # a result that cannot be unpickled here
                succeeded, value = False, error
            if succeeded:
                result.set_result(value)
            else:
                result.set_exception(value)
        self._remove(child)

    def _open_child(self, child: Child | None, environ: Mapping[str, str]) -> Child:
        with self._lock:
            if self._closed:
                raise _closed_error()
            if child is None:
                child = Child(__name__, "a worker process", environ=environ)
                self._children.append(child)
            return child

    def _remove(self, child: Child | None) -> None:
        if child is not None:
            with self._lock:
                self._children.remove(child)
            child.close()


def _closed_error() -> WorkerDiedError:
    return WorkerDiedError("the pool of processes is closed")


def main(requests: IO[bytes], replies: IO[bytes]) -> None:
    """The child's side: compute one task after another."""
    serve(lambda task: task[0](task[1]), requests, replies)
