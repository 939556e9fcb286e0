"""One call at a time: a vector environment's arrays are written by every call."""

from collections.abc import Iterator
from contextlib import contextmanager
from threading import Lock

from magical.errors import AlreadyPendingCallError


class PendingCall:
    """The call in progress, if any; a second one is refused, as in Gymnasium's AsyncVectorEnv."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._name = ""

    @contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        """Hold the block to be the only one; raises `AlreadyPendingCallError` if it is not."""
        if not self._lock.acquire(blocking=False):
            raise AlreadyPendingCallError(
                f"{name}: expected no call in progress, found a pending call of {self._name}; "
                "use a vector environment from one thread at a time, or one for each thread"
            )
        try:
            self._name = name
            yield
        finally:
            self._lock.release()
