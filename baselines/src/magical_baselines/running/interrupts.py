"""Handling Ctrl-C and SIGTERM between batches, so that no update is left half done."""

import signal
import threading
from types import FrameType
from typing import Any, Self

SIGNALS = (signal.SIGINT, signal.SIGTERM)


class Interrupts:
    """Context manager: the first signal sets `seen`, a second raises `KeyboardInterrupt`.

    In a program that embeds Python, signals whose handlers were not set from Python are left alone.
    """

    def __init__(self) -> None:
        self.seen = False
        self._before: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():  # only it may set handlers
            ours = [number for number in SIGNALS if signal.getsignal(number) is not None]
            self._before = {number: signal.signal(number, self._note) for number in ours}
        return self

    def __exit__(self, *error: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _note(self, number: int, frame: FrameType | None) -> None:
        if self.seen:
            raise KeyboardInterrupt
        self.seen = True
