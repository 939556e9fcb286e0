"""How much of the time goes into physics itself."""

import time
from collections.abc import Callable

import pymunk

_CALIBRATION_CALLS = 20_000


class PhysicsClock:
    """Adds up the time that this process spends inside `pymunk.Space.step`.

    Reading the clock twice around each call takes time too; what an empty call measures is
    subtracted. One clock can run at a time.
    """

    def __init__(self) -> None:
        self._measured = 0.0
        self._calls = 0
        self._bias = 0.0  # seconds that the measurement itself adds to each call
        self._original: Callable[[pymunk.Space, float], None] | None = None

    @property
    def seconds(self) -> float:
        """Seconds inside `pymunk.Space.step` since the first start."""
        return self._measured - self._calls * self._bias

    def start(self) -> None:
        """Begin, or continue, measuring; does nothing while running."""
        if self._original is not None:
            return
        self._bias = self._bias or _bias()
        self._original = pymunk.Space.step
        setattr(pymunk.Space, "step", self._timed(self._original))  # noqa: B010

    def stop(self) -> None:
        """Stop measuring; does nothing while stopped."""
        if self._original is not None:
            setattr(pymunk.Space, "step", self._original)  # noqa: B010
            self._original = None

    def _timed(
        self, step: Callable[[pymunk.Space, float], None]
    ) -> Callable[[pymunk.Space, float], None]:
        now = time.perf_counter

        def timed(space: pymunk.Space, dt: float) -> None:
            began = now()
            step(space, dt)
            self._measured += now() - began
            self._calls += 1

        return timed


def _bias() -> float:
    """What the clock shows, on average, for a call that does nothing."""

    def nothing(space: pymunk.Space, dt: float) -> None:
        pass

    clock, space = PhysicsClock(), pymunk.Space()
    timed = clock._timed(nothing)
    for _ in range(_CALIBRATION_CALLS):
        timed(space, 0.0)
    return clock.seconds / _CALIBRATION_CALLS
