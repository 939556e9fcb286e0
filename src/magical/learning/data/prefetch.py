"""Batches prepared ahead of time in a thread."""

import queue
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Generic, TypeVar

import torch

T = TypeVar("T")

DEPTH = 2  # batches in the queue
PUT_TIMEOUT = 0.1  # s between checks whether the consumer has stopped


@contextmanager
def prefetch(
    make: Callable[[int], T], numbers: Iterable[int], ahead: bool
) -> Iterator[Iterator[T]]:
    """Yield an iterator over the batches `make(number)`, in order.

    A thread makes them `ahead` of time, which is for batches that the host makes. What a GPU makes
    is made on demand: its kernels are queued asynchronously anyway. The iterator raises what `make`
    raises.
    """
    if not ahead:
        yield map(make, numbers)
        return
    loader = _Loader(make, numbers)
    try:
        yield iter(loader)
    finally:
        loader.stop()


class _Loader(Generic[T]):
    """A thread with a short queue; it uses one core and leaves the others to the main thread."""

    def __init__(self, make: Callable[[int], T], numbers: Iterable[int]) -> None:
        self._make = make
        self._numbers = numbers
        self._ready: queue.Queue[T | BaseException | None] = queue.Queue(DEPTH)
        self._single = threading.Event()
        self._stopped = threading.Event()
        num_threads = torch.get_num_threads()
        self._thread = threading.Thread(target=self._run, name="batches", daemon=True)
        self._thread.start()
        self._single.wait()
        # The number set in one thread is also the default of threads started later.
        torch.set_num_threads(num_threads)

    def __iter__(self) -> Iterator[T]:
        while (item := self._ready.get()) is not None:
            if isinstance(item, BaseException):
                raise item
            yield item

    def stop(self) -> None:
        """Stop the thread and wait for its end."""
        self._stopped.set()
        self._thread.join()

    def _run(self) -> None:
        torch.set_num_threads(1)
        self._single.set()
        try:
            for number in self._numbers:
                if not self._put(self._make(number)):
                    return
            self._put(None)
        except Exception as error:  # raised in the main thread
            self._put(error)

    def _put(self, item: T | BaseException | None) -> bool:
        """Put an item into the queue; false if the consumer has stopped."""
        while not self._stopped.is_set():
            try:
                self._ready.put(item, timeout=PUT_TIMEOUT)
            except queue.Full:
                continue
            return True
        return False
