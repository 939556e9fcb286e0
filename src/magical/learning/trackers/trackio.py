"""trackio, in the project named by TRACKIO_PROJECT (default: magical)."""

import os
from collections.abc import Iterator
from contextlib import contextmanager

from magical.extras import library
from magical.learning.trackers import Log, TrackedRun, Tracker


@contextmanager
def _opened(run: TrackedRun) -> Iterator[Log]:
    session = library("trackio", "tracker trackio").init(
        project=os.environ.get("TRACKIO_PROJECT", "magical"),
        name=f"{run.name}-{run.id[:8]}",  # trackio finds the run to resume by its name
        config=dict(run.config),
        resume="allow",
        embed=False,
        auto_log_cpu=False,
        auto_log_gpu=False,
    )
    try:
        yield lambda step, metrics: session.log(dict(metrics), step=step)
    finally:
        session.finish()


TRACKER = Tracker(_opened)
