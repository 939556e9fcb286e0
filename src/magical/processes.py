"""A function mapped over items in several processes, and how many there may be."""

import os
import signal
from collections import deque
from collections.abc import Callable, Container, Generator, Iterable
from threading import Thread
from typing import TypeVar, cast

from magical.errors import WorkerDiedError

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
    """Yield `work(item)` for each item, in order; arguments and errors as of `map_in_order`."""
    for _, result in map_in_order(work, items, workers):
        yield cast(Result, result)


def map_in_order(
    work: Callable[[Item], Result], items: Iterable[Item], workers: int, skip: Container[Item] = ()
) -> Generator[tuple[Item, Result | None], None, None]:
    """Yield each item with `work(item)`, computed in child processes, in the items' order.

    Only a few results wait at any time, so items may be infinite: close the generator when enough
    have come. The processes end with this one, however it ends.

    Args:
        work: a function that pickle can name, such as one at the top of a module, or a partial.
        items: items that can be pickled.
        workers: the number of processes; with 1 or less everything is done in this process. With
            more, the main script needs `if __name__ == "__main__":`.
        skip: the items that come with `None` instead, in their place.

    Raises:
        WorkerDiedError: a process was killed.
        Exception: what `work` raises.
    """
    if workers <= 1:
        for item in items:
            yield item, None if item in skip else work(item)
        return
    # Imported only here, as it takes ten milliseconds.
    from concurrent.futures import BrokenExecutor, Future, ProcessPoolExecutor
    from multiprocessing import get_context

    pool = ProcessPoolExecutor(workers, get_context("spawn"), initializer=_begin)
    waiting: deque[tuple[Item, Future[Result] | None]] = deque()
    try:
        for item in items:
            waiting.append((item, None if item in skip else pool.submit(work, item)))
            if len(waiting) > 2 * workers:
                first, future = waiting.popleft()
                yield first, None if future is None else future.result()
        for first, future in waiting:
            yield first, None if future is None else future.result()
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
