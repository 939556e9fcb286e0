"""Trackers: TensorBoard and Weights & Biases get the metrics of a run, too."""

import hashlib
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from magical.errors import InvalidConfigError
from magical.extras import library
from magical.runs.folder import CONFIG, RECORD, TENSORBOARD, read_json

TRACKERS = ("tensorboard", "wandb")


@contextmanager
def opened_trackers(
    names: Sequence[str], folder: Path, step: int
) -> Iterator[Callable[[int, Mapping[str, float | str]], None]]:
    """Context manager whose value, `log(step, metrics)`, sends the numbers to these trackers.

    Training continues from `step`. Later steps that a tracker already has are logged again.

    Raises:
        InvalidConfigError: there is no tracker with one of the names.
        MissingDependencyError: a tracker's library is not installed.
    """
    if unknown := set(names) - set(TRACKERS):
        raise InvalidConfigError(f"track: expected {' or '.join(TRACKERS)}, found {min(unknown)!r}")
    with ExitStack() as stack:
        writer, session = None, None
        if "tensorboard" in names:
            library("tensorboard", "tracker tensorboard")
            from torch.utils.tensorboard import SummaryWriter

            tensorboard = SummaryWriter(str(folder / TENSORBOARD), purge_step=step + 1)
            writer = stack.enter_context(tensorboard)
        if "wandb" in names:
            session = stack.enter_context(_wandb_session(folder))

        def log(step: int, metrics: Mapping[str, float | str]) -> None:
            numbers = {name: value for name, value in metrics.items() if not isinstance(value, str)}
            if writer:
                for name, value in numbers.items():
                    writer.add_scalar(name, value, step)
            if session and numbers:
                session.log(numbers, step=step)

        yield log


def _wandb_session(folder: Path) -> Any:
    """A session of Weights & Biases, which continues the run's earlier ones."""
    name, config = folder.resolve().name, read_json(folder / CONFIG)
    sha = hashlib.sha256(f"{name} {read_json(folder / RECORD).get('began')} {config}".encode())
    return library("wandb", "tracker wandb").init(
        project=os.environ.get("WANDB_PROJECT", "magical"),
        id=sha.hexdigest()[:32],
        name=name,
        config=config,
        resume="allow",
    )
