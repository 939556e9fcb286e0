"""A plan that takes seconds, and its execution in this process."""

from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path

import pytest

from magical_baselines.experiments.plan import PlannedRun, planned_runs, read_plan
from magical_baselines.experiments.results import Outcome, Results

# What needs PyTorch cannot even be imported without it.
collect_ignore_glob = [] if find_spec("torch") else ["test_*.py"]

Planned = Callable[..., list[PlannedRun]]  # the fixture `planned`
Started = list[PlannedRun]  # the fixture `inline`

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
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A plan of two runs."""
    path = tmp_path_factory.mktemp("plans") / "tiny.toml"
    path.write_text(TINY)
    return path


@pytest.fixture(scope="session")
def planned(tiny: Path) -> Planned:
    """The runs of the tiny plan, with parts of its text replaced."""

    def make(*changes: tuple[str, str], demos: str | None = None) -> list[PlannedRun]:
        text = tiny.read_text()
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        path = tiny.with_name("changed.toml")
        path.write_text(text)
        return planned_runs(read_plan(path, demos))

    return make


class InlineExecutor:
    """Finishes each run when it is started, in this process."""

    def __init__(self, results: Results, started: Started) -> None:
        self.results, self.started = results, started

    def slots(self) -> int:
        return 1

    def start(self, run: PlannedRun, demos: Path | None) -> Future[Outcome]:
        from magical_baselines.experiments.one_run import finish

        self.started.append(run)
        future: Future[Outcome] = Future()
        try:
            future.set_result(finish(run, self.results.folder(run), demos))
        except OSError as error:  # a process would pass it on
            future.set_exception(error)
        return future

    def stop(self) -> None:
        """Nothing is ever in progress."""

    def close(self) -> None:
        """There is nothing to close."""


@pytest.fixture
def out(tmp_path: Path) -> Path:
    """No results yet."""
    return tmp_path / "out"


@contextmanager
def in_this_process() -> Iterator[Started]:
    """A context in which plans are executed in this process; the list of the runs started."""
    started: Started = []

    def make(runs: list[PlannedRun], results: Results, resources: object) -> InlineExecutor:
        return InlineExecutor(results, started)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("magical_baselines.experiments.execution._executor", make)
        patch.setattr("magical.processes.pool.available_cores", lambda: 1)
        yield started


@pytest.fixture
def inline() -> Iterator[Started]:
    """Execute plans in this process; the list of the runs that were started."""
    with in_this_process() as started:
        yield started


@pytest.fixture(scope="session")
def finished(planned: Planned, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The results of the tiny plan; not to be changed."""
    from magical_baselines.experiments.execution import execute

    path = tmp_path_factory.mktemp("finished") / "out"
    with in_this_process():
        assert execute(planned(), path).complete
    return path
