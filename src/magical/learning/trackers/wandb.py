"""Weights & Biases, in the project named by WANDB_PROJECT (default: magical)."""

import os
from collections.abc import Iterator
from contextlib import contextmanager

from magical.extras import library
from magical.learning.trackers import Log, TrackedRun, Tracker


@contextmanager
def _opened(run: TrackedRun) -> Iterator[Log]:
    with library("wandb", "tracker wandb").init(
        project=os.environ.get("WANDB_PROJECT", "magical"),
        id=run.id,
        name=run.name,
        config=dict(run.config),
        resume="allow",
    ) as session:
        yield lambda step, metrics: session.log(dict(metrics), step=step)


TRACKER = Tracker(_opened)
