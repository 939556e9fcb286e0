"""Batches prepared ahead of time in a thread."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from typing import TypeVar

import torch

T = TypeVar("T")

DEPTH = 2  # batches ahead of the one in use


@contextmanager
def prefetch(
    make: Callable[[int], T], numbers: Iterable[int], ahead: bool
) -> Iterator[Iterator[T]]:
    """Yield an iterator over the batches `make(number)`, in order.

    If `ahead`, a thread makes them in advance, on one core, and leaves the others to the main
    thread: this is for batches made by the host. Batches made on a GPU are made on demand, as its
    kernels are queued asynchronously anyway. The iterator raises what `make` raises.
    """
    if not ahead:
        yield map(make, numbers)
        return
    num_threads = torch.get_num_threads()
    thread = ThreadPoolExecutor(1, "batches", torch.set_num_threads, (1,))
    # The number set in one thread is also the default for threads started later, and a thread takes
    # the default of the time at which it first asks.
    thread.submit(torch.get_num_threads).result()
    torch.set_num_threads(num_threads)
    try:
        yield _ahead(thread, make, numbers)
    finally:
        thread.shutdown(cancel_futures=True)


def _ahead(
    thread: ThreadPoolExecutor, make: Callable[[int], T], numbers: Iterable[int]
) -> Iterator[T]:
    queue: deque[Future[T]] = deque()
    for number in numbers:
        queue.append(thread.submit(make, number))
        if len(queue) > DEPTH:
            yield queue.popleft().result()
    while queue:
        yield queue.popleft().result()
