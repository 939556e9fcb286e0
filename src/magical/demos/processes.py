"""The same work for many items, in several processes, results in order."""

import os
from collections import deque
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import Future, ProcessPoolExecutor
from multiprocessing import get_context
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")


def usable_cores() -> int:
    """The number of processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def in_processes(
    work: Callable[[Item], Result], items: Iterable[Item], workers: int | None = None
) -> Generator[Result, None, None]:
    """`work(item)` for each item, in the items' order; only a few results wait at any time.

    `workers` defaults to the usable cores; with 1 everything happens here. Items may be without
    end: closing the iterator stops the work.
    """
    count = usable_cores() if workers is None else workers
    if count <= 1:
        yield from map(work, items)
        return
    # Spawned, not forked: a fork would copy threads of compiled libraries in an unknown state.
    pool = ProcessPoolExecutor(count, mp_context=get_context("spawn"))
    try:
        waiting: deque[Future[Result]] = deque()
        for item in items:
            waiting.append(pool.submit(work, item))
            if len(waiting) > 2 * count:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:
        pool.shutdown(cancel_futures=True)
