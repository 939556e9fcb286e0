"""Batches prepared ahead in a thread, so that the learner never waits."""

import queue
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Generic, TypeVar

import torch

Batch = TypeVar("Batch")

DEPTH = 2  # batches ready at most
PATIENCE = 0.1  # s between looks at whether the learner has left


@contextmanager
def prepared(
    make: Callable[[int], Batch], numbers: Iterable[int], device: str
) -> Iterator[Iterator[Batch]]:
    """The batches `make(number)`, in order; whatever `make` raises comes out of the iterator.

    On a CPU a thread makes them ahead. On a GPU they are made in turn: its kernels are queued
    anyway, and the queue keeps it busy.
    """
    if device != "cpu":
        yield map(make, numbers)
        return
    worker = _Worker(make, numbers)
    try:
        yield iter(worker)
    finally:
        worker.stop()


class _Worker(Generic[Batch]):
    """A thread with a short queue. It computes on one core: the other ones are the learner's."""

    def __init__(self, make: Callable[[int], Batch], numbers: Iterable[int]) -> None:
        self._make = make
        self._numbers = numbers
        self._ready: queue.Queue[Batch | BaseException | None] = queue.Queue(DEPTH)
        self._single = threading.Event()
        self._left = threading.Event()
        learners = torch.get_num_threads()
        self._thread = threading.Thread(target=self._run, name="batches", daemon=True)
        self._thread.start()
        self._single.wait()
        # Setting the number of threads in one thread also changes what the next new ones get.
        torch.set_num_threads(learners)

    def __iter__(self) -> Iterator[Batch]:
        while (item := self._ready.get()) is not None:
            if isinstance(item, BaseException):
                raise item
            yield item

    def stop(self) -> None:
        """Let the thread end, and wait for it."""
        self._left.set()
        self._thread.join()

    def _run(self) -> None:
        torch.set_num_threads(1)
        self._single.set()
        try:
            for number in self._numbers:
                if not self._put(self._make(number)):
                    return
            self._put(None)
        except Exception as error:  # it belongs to the learner
            self._put(error)

    def _put(self, item: Batch | BaseException | None) -> bool:
        """Whether the learner is still there to take it."""
        while not self._left.is_set():
            try:
                self._ready.put(item, timeout=PATIENCE)
            except queue.Full:
                continue
            return True
        return False
