"""`magical run` in a process of its own, for tests that end it."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from magical.evaluation import Evaluation
from magical_baselines.experiments.one_run import reference_folder, write_result
from magical_baselines.experiments.plan import PlannedRun
from magical_baselines.experiments.results import Outcome
from tests.waiting import soon

TIMEOUT = 120.0  # seconds, on a busy machine


@contextmanager
def running(plan: Path, out: Path, *options: str) -> Iterator["subprocess.Popen[str]"]:
    """A process that executes a plan, one run at a time; killed at the end."""
    command = [sys.executable, "-m", "magical", "run", str(plan), "--out", str(out), *options]
    with subprocess.Popen(
        [*command, "--workers", "1"], stderr=subprocess.PIPE, text=True
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def finish(run: PlannedRun, folder: Path, demos: Path | None) -> Outcome:
    """As the package's, without training; the process of the run with seed 0 is killed."""
    if run.seed == 0:
        os.kill(os.getpid(), signal.SIGKILL)
    write_result(run, folder, state="done")
    return Outcome("done")


def evaluate_reference(reference: tuple[str, Evaluation], results: Path) -> None:
    """As the package's, without rollouts; the process that evaluates `noop` is killed."""
    if reference[0] == "noop":
        os.kill(os.getpid(), signal.SIGKILL)
    (results / "references" / reference_folder(reference)).mkdir(parents=True)


def lines(out: Path) -> int:
    """How much has been written: lines of metrics, and finished runs."""
    metrics = sum(path.read_text().count("\n") for path in out.glob("runs/*/metrics.jsonl"))
    return metrics + len(list(out.glob("runs/*/result.json")))


def reached(out: Path, moment: int) -> bool:
    """Whether so many lines and records are written in time."""
    return soon(lambda: lines(out) >= moment, TIMEOUT)


def scores_of(out: Path) -> dict[str, bytes]:
    """The scores of each run of a results folder."""
    return {path.parent.name: path.read_bytes() for path in out.glob("runs/*/scores.csv")}
