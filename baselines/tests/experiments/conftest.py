"""A plan that takes seconds, and its execution in this process."""

import os
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import contextmanager
from typing import Any

import pytest

from magical_baselines.experiments.plan import PlannedRun, planned_runs, read_plan
from tests.waiting import soon

Planned = Callable[..., list[PlannedRun]]  # the fixture `planned`
TIMEOUT = 300.0  # seconds for a plan in a process of its own, on a busy machine

TINY = """
tasks = ["MoveToRegion"]
seeds = [0, 1]
num_demos = 2
expert_demos = 3
preset = "quick"
rollouts = 1
nudge = 1e-9
variants = ["Demo"]

[[methods]]
name = "BC tiny"
algorithm = "bc"
settings = { batches = 6, batch_size = 4, log_every = 1, checkpoint_every = 2 }
"""


@pytest.fixture(scope="session")
def tiny(tmp_path_factory):
    """A plan of two runs."""
    path = tmp_path_factory.mktemp("plans") / "tiny.toml"
    path.write_text(TINY)
    return path


@pytest.fixture(scope="session")
def planned(tiny):
    """The runs of the tiny plan, with parts of its text replaced."""

    def make(*changes, demos=None):
        text = tiny.read_text()
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        path = tiny.with_name("changed.toml")
        path.write_text(text)
        return planned_runs(read_plan(path, demos))

    return make


class Inline:
    """An executor that finishes each run when it is submitted, in this process."""

    def __init__(self):
        self.started: list[Any] = []

    def submit(self, work, folder, demos):
        from magical_baselines.experiments import one_run

        self.started.append(work)
        future: Future[None] = Future()
        try:
            future.set_result(one_run.finish(work, folder, demos))
        except Exception as error:  # a process would pass it on
            future.set_exception(error)
        return future

    def stop(self):
        """Nothing is ever in progress."""

    def close(self):
        """There is nothing to close."""


def execute(runs, out, **options):
    """Execute a plan in this process; what was started."""
    from magical_baselines.experiments import execution

    inline = Inline()
    execution.execute(runs, out, inline, workers=1, **options)
    return inline.started


@pytest.fixture
def out(tmp_path):
    """No results yet."""
    return tmp_path / "out"


@pytest.fixture(scope="session")
def finished(planned, tmp_path_factory):
    """The results of the tiny plan; not to be changed."""
    path = tmp_path_factory.mktemp("finished") / "out"
    execute(planned(), path)
    return path


@contextmanager
def running(plan, out, *options):
    """A process that executes a plan, one run at a time; killed at the end."""
    command = [sys.executable, "-m", "magical", "run", str(plan), "--out", str(out), *options]
    environ = {**os.environ, "RAY_USAGE_STATS_ENABLED": "0"}
    with subprocess.Popen(
        [*command, "--workers", "1"], stderr=subprocess.PIPE, text=True, env=environ
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def reached(out, moment):
    """Whether so many lines of metrics and records of finished runs are written in time."""

    def written():
        lines = sum(path.read_text().count("\n") for path in out.glob("runs/*/metrics.jsonl"))
        return lines + len(list(out.glob("runs/*/result.json"))) >= moment

    return soon(written, TIMEOUT)


def scores_of(out):
    """The scores of each run of a results folder."""
    return {path.parent.name: path.read_bytes() for path in out.glob("runs/*/scores.csv")}
