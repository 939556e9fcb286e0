"""Trackers: what each library is told of a run, and that a run that is resumed continues there."""

import sys
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from magical.cli import main
from magical.errors import MissingDependencyError, UnknownNameError
from magical.learning import train
from magical.learning.algorithms.bc import BCConfig
from magical.learning.trackers import Log, TrackedRun, Tracker, opened_trackers, tracker_names
from magical.runs import read_metrics
from magical.runs.folder import opened_folder
from tests.learning.tiny_runs import tiny

CONFIGURATION = {"algorithm": "bc", "seed": 3}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    path = tmp_path / "run"
    with opened_folder(path, CONFIGURATION, resume=False):
        return path


class Library:
    """Stands for a tracker's module: keeps what its functions are called with."""

    def __init__(self) -> None:
        self.opened: list[dict[str, Any]] = []
        self.logged: list[tuple[int, dict[str, float]]] = []
        self.closed = 0

    def log(self, metrics: dict[str, float], step: int) -> None:
        self.logged.append((step, metrics))

    def finish(self) -> None:
        self.closed += 1


class Wandb(Library):
    def init(self, **arguments: Any) -> AbstractContextManager[Any]:
        self.opened.append(arguments)
        return self._session()

    @contextmanager
    def _session(self) -> Any:
        yield self
        self.finish()


class Trackio(Library):
    def init(self, **arguments: Any) -> Any:
        self.opened.append(arguments)
        return self


class MLflow(Library):
    """Its client finds a run by the tag it began with."""

    def __init__(self) -> None:
        super().__init__()
        self.params: list[dict[str, Any]] = []
        self.log_params = self.params.append

    def set_experiment(self, name: str) -> Any:
        return SimpleNamespace(experiment_id=f"id of {name}")

    def MlflowClient(self) -> Any:
        return self

    def search_runs(self, experiments: list[str], query: str, max_results: int) -> list[Any]:
        assert experiments == ["id of magical"]
        begun = [f"tags.`magical.run` = '{run['tags']['magical.run']}'" for run in self.opened]
        return [SimpleNamespace(info=SimpleNamespace(run_id="first"))] if query in begun else []

    def start_run(self, **arguments: Any) -> AbstractContextManager[None]:
        self.opened.append(arguments)
        return nullcontext()

    def log_metrics(self, metrics: dict[str, float], step: int) -> None:
        self.log(metrics, step)


def log_twice(name: str, folder: Path) -> None:
    """Log as a run does that is interrupted after step 4, with a checkpoint of step 2."""
    metrics: dict[str, float | str] = {"loss": 0.5, "phase": "second"}
    for step, steps in ((0, (2, 4)), (2, (4, 6))):
        with opened_trackers([name], folder, step) as log:
            for number in steps:
                log(number, metrics)


@pytest.mark.parametrize(("name", "kind"), [("wandb", Wandb), ("trackio", Trackio)])
def test_sessions_are_opened_and_closed(
    name: str, kind: Callable[[], Library], folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, name, library := kind())
    log_twice(name, folder)
    first, second = library.opened
    assert first == second  # so that the second continues the first
    assert (first["project"], first["resume"], first["config"]) == (
        ("magical", "allow", CONFIGURATION)
    )
    assert first["name"].startswith("run")
    assert library.logged == [(step, {"loss": 0.5}) for step in (2, 4, 4, 6)]
    assert library.closed == 2


def test_mlflow_continues_the_run_that_has_its_tag(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "mlflow", library := MLflow())
    log_twice("mlflow", folder)
    assert [run["run_id"] for run in library.opened] == [None, "first"]
    assert library.params == [CONFIGURATION]  # once: parameters of a run cannot be changed
    assert library.logged == [(step, {"loss": 0.5}) for step in (2, 4, 4, 6)]


def test_tensorboard_gets_the_metrics(folder: Path) -> None:
    pytest.importorskip("tensorboard")
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    log_twice("tensorboard", folder)
    events = EventAccumulator(str(folder / "tensorboard"))
    events.Reload()
    assert [(e.step, e.value) for e in events.Scalars("loss")] == [(2, 0.5), (4, 0.5), (6, 0.5)]


def test_runs_have_ids_of_their_own(folder: Path, tmp_path: Path) -> None:
    other = tmp_path / "other"
    with opened_folder(other, CONFIGURATION, resume=False):
        pass
    first, resumed, second = (TrackedRun.of(path, 0).id for path in (folder, folder, other))
    assert first == resumed != second


def test_a_missing_library_is_named_with_its_command(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "wandb", None)
    with (
        pytest.raises(MissingDependencyError, match=r"tracker wandb.*pip install wandb"),
        opened_trackers(["wandb"], folder, 0),
    ):
        pass
    with pytest.raises(UnknownNameError, match="mlflow, tensorboard, trackio, wandb"):
        opened_trackers(["aim"], folder, 0).__enter__()
    assert tracker_names() == ["mlflow", "tensorboard", "trackio", "wandb"]


LINES: list[tuple[int, Mapping[str, float]]] = []


@contextmanager
def _kept(run: TrackedRun) -> Any:
    LINES.clear()
    log: Log = lambda step, metrics: LINES.append((step, metrics))  # noqa: E731
    yield log


KEPT = Tracker(_kept)


def test_training_logs_every_line_to_a_tracker_of_another_module(
    demos: Path, tmp_path: Path
) -> None:
    config = tiny(BCConfig, tasks=("MoveToCorner",), demos=str(demos))
    train(config, tmp_path / "run", track=[f"{__name__}:KEPT"])
    rows = read_metrics(tmp_path / "run")
    assert [step for step, _ in LINES] == [row["step"] for row in rows] != []
    assert [m["loss"] for _, m in LINES] == pytest.approx([r["loss"] for r in rows], abs=1e-6)


def test_the_command_names_the_missing_library_and_leaves_no_folder(
    demos: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setitem(sys.modules, "mlflow", None)
    out = tmp_path / "run"
    command = ["train", "bc", "--task", "MoveToCorner", "--demos", str(demos), "--out", str(out)]
    assert main([*command, "--preset", "quick", "--track", "mlflow"]) == 1
    assert "pip install mlflow" in capsys.readouterr().err
    assert not out.exists()
