"""Trackers: what each library is told of a run, and that a run that is resumed continues there."""

import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Self

import pytest

from baselines.tests.tiny_runs import tiny
from magical.cli import main
from magical.errors import InvalidConfigError, MissingDependencyError
from magical.runs import RECORD, read_json
from magical_baselines import train
from magical_baselines.algorithms.bc import BCConfig
from magical_baselines.run import opened_trackers
from magical_baselines.run_folder import opened_folder

CONFIGURATION = tiny(BCConfig, seed=3)


class Wandb:
    """Stands for the library and its sessions: keeps what its functions are called with."""

    def __init__(self) -> None:
        self.opened: list[dict[str, Any]] = []
        self.logged: list[tuple[int, dict[str, float]]] = []
        self.closed = 0

    def init(self, **arguments: Any) -> Self:
        self.opened.append(arguments)
        return self

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.closed += 1

    def log(self, metrics: dict[str, float], step: int) -> None:
        self.logged.append((step, metrics))


@pytest.fixture
def wandb(monkeypatch: pytest.MonkeyPatch) -> Wandb:
    library = Wandb()
    monkeypatch.setitem(sys.modules, "wandb", library)
    monkeypatch.delenv("WANDB_PROJECT", raising=False)
    return library


@pytest.fixture
def begin(tmp_path: Path) -> Callable[[str], Path]:
    """A function that makes a run folder."""

    def make(name: str) -> Path:
        with opened_folder(tmp_path / name, CONFIGURATION.to_dict(), resume=False):
            return tmp_path / name

    return make


def log_twice(name: str, folder: Path) -> None:
    """Log as a run does that is interrupted after step 4, with a checkpoint of step 2."""
    metrics: dict[str, float | str] = {"loss": 0.5, "phase": "second"}
    for step, steps in ((0, (2, 4)), (2, (4, 6))):
        run: Any = SimpleNamespace(
            folder=folder, step=step, config=CONFIGURATION, record=read_json(folder / RECORD)
        )
        with opened_trackers([name], run) as log:
            assert log
            for number in steps:
                log(number, metrics)


def test_a_session_of_wandb_continues_the_run(wandb: Wandb, begin: Callable[[str], Path]) -> None:
    log_twice("wandb", begin("run"))
    first, second = wandb.opened
    assert first == second  # so that the second continues the first
    assert (first["name"], first["project"], first["resume"], first["config"]) == (
        ("run", "magical", "allow", CONFIGURATION.to_dict())
    )
    assert wandb.logged == [(step, {"loss": 0.5}) for step in (2, 4, 4, 6)]
    assert wandb.closed == 2
    log_twice("wandb", begin("other"))
    assert wandb.opened[2]["id"] != first["id"]


def test_tensorboard_gets_the_metrics(begin: Callable[[str], Path]) -> None:
    pytest.importorskip("tensorboard")
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    log_twice("tensorboard", folder := begin("run"))
    events = EventAccumulator(str(folder / "tensorboard"))
    events.Reload()
    assert [(e.step, e.value) for e in events.Scalars("loss")] == [(2, 0.5), (4, 0.5), (6, 0.5)]


def test_an_unknown_tracker_is_refused() -> None:
    with (
        pytest.raises(InvalidConfigError, match="expected tensorboard or wandb, found 'aim'"),
        opened_trackers(["aim"], SimpleNamespace()),
    ):
        pass


def test_the_command_names_the_missing_library_and_leaves_no_folder(
    demos: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setitem(sys.modules, "wandb", None)
    config = tiny(BCConfig, tasks=("MoveToCorner",), demos=str(demos))
    with pytest.raises(MissingDependencyError, match=r"tracker wandb.*pip install wandb"):
        train(config, tmp_path / "first", track=["wandb"])
    out = tmp_path / "run"
    command = ["train", "bc", "--task", "MoveToCorner", "--demos", str(demos), "--out", str(out)]
    assert main([*command, "--preset", "quick", "--track", "wandb"]) == 1
    assert "pip install wandb" in capsys.readouterr().err
    assert not out.exists()
