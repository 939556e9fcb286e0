"""TensorBoard: event files in the run folder (extra `tensorboard`)."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager

from magical.extras import require
from magical.learning.trackers import Log, TrackedRun, Tracker
from magical.runs.folder import TENSORBOARD


@contextmanager
def _opened(run: TrackedRun) -> Iterator[Log]:
    require("tensorboard")
    from torch.utils.tensorboard import SummaryWriter

    with SummaryWriter(str(run.folder / TENSORBOARD), purge_step=run.step + 1) as writer:

        def log(step: int, metrics: Mapping[str, float]) -> None:
            for name, value in metrics.items():
                writer.add_scalar(name, value, step)

        yield log


TRACKER = Tracker(_opened)
