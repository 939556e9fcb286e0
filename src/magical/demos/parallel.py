"""A function mapped over items in processes, with few results waiting at a time."""

import signal
from collections import deque
from collections.abc import Callable, Container, Generator, Iterable
from concurrent.futures import BrokenExecutor, Future, ProcessPoolExecutor
from multiprocessing import get_context
from typing import TypeVar

from magical.errors import WorkerDiedError

Item = TypeVar("Item")
Result = TypeVar("Result")


def map_in_order(
    work: Callable[[Item], Result], items: Iterable[Item], workers: int, skip: Container[Item] = ()
) -> Generator[tuple[Item, Result | None], None, None]:
    """Yield each item with `work(item)`, in order; None for the items in `skip`.

    Items may be infinite: close the generator when enough have come. With one worker everything is
    done in this process. Raises `WorkerDiedError` if a process is killed.
    """
    if workers == 1:
        for item in items:
            yield item, None if item in skip else work(item)
        return
    pool = ProcessPoolExecutor(
        workers,
        get_context("spawn"),
        initializer=signal.signal,  # the main process ends them
        initargs=(signal.SIGINT, signal.SIG_IGN),
    )
    try:
        waiting: deque[tuple[Item, Future[Result] | None]] = deque()
        for item in items:
            waiting.append((item, None if item in skip else pool.submit(work, item)))
            if len(waiting) > workers:
                first, future = waiting.popleft()
                yield first, None if future is None else future.result()
        for first, future in waiting:
            yield first, None if future is None else future.result()
    except BrokenExecutor as error:
        raise WorkerDiedError("a worker process was killed, perhaps for lack of memory") from error
    finally:
        pool.shutdown(cancel_futures=True)
