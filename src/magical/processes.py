"""A function mapped over items in several processes, and how many there may be."""

import os
import signal
from collections import deque
from collections.abc import Callable, Generator, Iterable
from threading import Thread
from typing import TypeVar

from magical.errors import WorkerDiedError

Item = TypeVar("Item")
Result = TypeVar("Result")


def available_cores() -> int:
    """The number of processor cores that this process may use."""
    affinity = getattr(os, "sched_getaffinity", None)  # not on macOS and Windows
    return len(affinity(0)) if affinity else os.cpu_count() or 1


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
    """Yield `work(item)` for each item, computed in child processes, in the items' order.

    Only a few results wait at any time, so items may be infinite: close the generator when enough
    have come. The processes end with this one, however it ends.

    Args:
        work: a function that pickle can name, such as one at the top of a module, or a partial.
        items: items that can be pickled.
        workers: the number of processes; with 1 or less everything is done in this process. With
            more, the main script needs `if __name__ == "__main__":`.

    Raises:
        WorkerDiedError: a process was killed.
        Exception: what `work` raises.
    """
    if workers <= 1:
        yield from map(work, items)
        return
    # Imported only here, as it takes ten milliseconds.
    from concurrent.futures import BrokenExecutor, Future, ProcessPoolExecutor
    from multiprocessing import get_context

    pool = ProcessPoolExecutor(workers, get_context("spawn"), initializer=_begin)
    waiting: deque[Future[Result]] = deque()
    try:
        for item in items:
            waiting.append(pool.submit(work, item))
            if len(waiting) > 2 * workers:
                yield waiting.popleft().result()
        for future in waiting:
            yield future.result()
    except BrokenExecutor as error:
        raise WorkerDiedError("a worker process was killed, perhaps for lack of memory") from error
    finally:
        pool.shutdown(cancel_futures=True)


def _begin() -> None:
    """In a new process: leave Ctrl-C to the parent, and end when it does."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    from multiprocessing import parent_process

    if parent := parent_process():
        parent.join()
    os._exit(1)
