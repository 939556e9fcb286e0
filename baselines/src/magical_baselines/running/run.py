"""A run in progress: an algorithm's interface to its run folder.

The folder's files are described in `magical.runs.folder`.
"""

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, Self

import torch

from magical.errors import DivergedError, InvalidConfigError, RunFolderError
from magical.messages import quoted
from magical.runs.folder import CHECKPOINT, RECORD, read_json, write_json
from magical.runs.metrics import MetricsWriter
from magical_baselines.config import CHECKPOINT_SECONDS, Config
from magical_baselines.running.checkpoints import (
    StateDict,
    load_checkpoint,
    restoring,
    save_checkpoint,
)
from magical_baselines.running.devices import Compute, Device, choose_compute, read_compute
from magical_baselines.running.interrupts import Interrupts
from magical_baselines.running.streams import Purpose, seed_torch

Metrics = Mapping[str, float | str]
Callback = Callable[[int, Metrics], object]  # step, metrics

SAVING_SHARE = 0.05  # of training time is for saving checkpoints, at most


class Run:
    """Logs metrics, saves checkpoints and decides when to stop.

    In each step, PyTorch's global random numbers, such as those for dropout, are determined by the
    seed and the step's number.

    Attributes:
        folder: the run folder.
        saved: the checkpoint to resume from, or `None` in a new run.
        step: the number of steps (batches or updates) done at the newest checkpoint.
        callbacks: functions called after each line of metrics.
    """

    def __init__(
        self,
        folder: Path,
        config: Config,
        *,
        interrupts: Interrupts | None = None,
        stop_after: int | None = None,
    ) -> None:
        """See `magical_baselines.train`.

        Raises:
            CheckpointError: the checkpoint is damaged.
            InvalidConfigError: `stop_after` is below 1.
        """
        if stop_after is not None and stop_after < 1:
            raise InvalidConfigError(f"stop_after: expected a positive number, found {stop_after}")
        self.folder = folder
        self._seed, self._checkpoint_every = config.seed, config.checkpoint_every
        asked = (f"device {config.device}", f"precision {config.precision}")
        # What the algorithm would ignore if it did not call `compute`.
        self._ignored = [each for each in asked if each in ("device cuda", "precision bfloat16")]
        self.callbacks: list[Callback] = []
        self._interrupts = interrupts or Interrupts()
        self.record = read_json(folder / RECORD) if (folder / RECORD).exists() else {}
        path = folder / CHECKPOINT
        self.saved: StateDict | None = load_checkpoint(path) if path.exists() else None
        with restoring(folder):
            self.step = int(self.saved["step"]) if self.saved else 0
        self._last = math.inf if stop_after is None else self.step + stop_after
        self._saved_at, self._pause = time.monotonic(), float(CHECKPOINT_SECONDS)
        self._metrics = MetricsWriter(folder, self.step)
        seed_torch(self._seed, Purpose.NOISE, self.step)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._metrics.close()

    def describe(self, **facts: Any) -> None:
        """Record facts in `run.json`; a resumed run must have the same ones.

        Raises `RunFolderError` if a fact has changed since the run was started.
        """
        for name, fact in facts.items():
            if name in self.record and self.record[name] != fact:
                raise RunFolderError(
                    f"{self.folder}: the run began with other {name}; expected "
                    f"{_first_difference(self.record[name], fact)}; restore what it began with, or "
                    "start a new run"
                )
        if not set(facts) <= set(self.record):
            self._write_record(facts)

    def compute(self, device: Device, precision: str, threads: int) -> Compute:
        """Device, precision and threads: as recorded, or chosen by `devices.choose_compute`.

        A run that is resumed on another kind of device chooses again.
        """
        recorded = read_compute(self.record, self.folder)
        if recorded and recorded.device == device:
            chosen = recorded
        else:
            chosen = choose_compute(device, precision, threads)
            self._write_record({"compute": asdict(chosen)})
        chosen.set_threads()
        self._ignored = []
        return chosen

    def _write_record(self, facts: Mapping[str, Any]) -> None:
        self.record = {**self.record, **facts}
        write_json(self.folder / RECORD, self.record)

    def finish_step(
        self,
        step: int,
        metrics: Callable[[], Metrics],
        state: Callable[[], StateDict],
        *,
        log_every: int = 1,
        last: bool = False,
    ) -> bool:
        """End a step: log metrics, check them, and save a checkpoint, each if due.

        All three are done at the last step, and when the run is interrupted or has to stop.

        Args:
            step: the number of steps done.
            metrics: called to get the metrics since they were last logged.
            state: called to get the state to save.
            log_every: steps between lines of metrics.
            last: whether the algorithm, or a part of it, ends with this step.

        Returns:
            Whether the run stops here.

        Raises:
            DivergedError: metrics or state are not finite; the checkpoint is left unchanged.
            InvalidConfigError: a device or a precision is asked for, and the algorithm has not
                called `compute`.
        """
        if self._ignored:
            raise InvalidConfigError(
                f"{' and '.join(self._ignored)}: this algorithm does not take them, since its "
                "train function does not call run.compute; leave them out"
            )
        stops = self._interrupts.seen or step >= self._last
        if stops or last or step % log_every == 0:
            found = metrics()
            self._metrics.write(step, found)
            for callback in self.callbacks:
                callback(step, found)
            self._require_finite(step, found)
        if stops or last or self._checkpoint_is_due(step):
            begun = time.monotonic()
            saved = state()
            self._require_finite(step, saved)
            save_checkpoint(self.folder / CHECKPOINT, {**saved, "step": step})
            self.step, self._saved_at = step, time.monotonic()
            self._pause = max(CHECKPOINT_SECONDS, (self._saved_at - begun) / SAVING_SHARE)
        seed_torch(self._seed, Purpose.NOISE, step)
        return stops

    def _checkpoint_is_due(self, step: int) -> bool:
        if self._checkpoint_every:
            return step % self._checkpoint_every == 0
        return time.monotonic() - self._saved_at >= self._pause

    def _require_finite(self, step: int, state: Any) -> None:
        """Raise `DivergedError` if any number or tensor in nested dicts and lists is not finite."""
        if not _is_finite(state):
            kept = f"the checkpoint of step {self.step}" if self.step else "no checkpoint"
            raise DivergedError(
                f"training diverged: at step {step} the loss or the weights are not finite; "
                f"{self.folder} keeps {kept}. Try a smaller learning rate or --precision float32"
            )


def _is_finite(node: Any) -> bool:
    if isinstance(node, torch.Tensor):
        return not node.is_floating_point() or bool(torch.isfinite(node).all())
    if isinstance(node, Mapping):
        return all(map(_is_finite, node.values()))
    if isinstance(node, list | tuple):
        return all(map(_is_finite, node))
    return not isinstance(node, float) or math.isfinite(node)


def _first_difference(before: Any, now: Any) -> str:
    """Two values for a message, or of two lists the first items that differ."""
    if isinstance(before, list) and isinstance(now, list):
        pairs = (pair for pair in zip(before, now, strict=False) if pair[0] != pair[1])
        before, now = next(pairs, (before, now))
    return f"{quoted(before)}, found {quoted(now)}"
