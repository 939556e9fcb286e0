"""Runs of any algorithm: logging, checkpoints, facts; and configurations."""

import json
import math
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import torch

from magical.errors import DivergedError, InvalidConfigError, RunFolderError, UnknownNameError
from magical.learning.algorithms.bc import BCConfig
from magical.learning.config import CHECKPOINT_SECONDS, options
from magical.learning.running.devices import restored_threads
from magical.learning.running.run import Run
from magical.runs import opened_folder, read_metrics
from magical.runs.folder import CONFIG, METRICS, RECORD

CONFIGURATION = BCConfig(tasks=("MoveToCorner",), demos="demos")


def opened(folder: Path, stop_after: int | None = None, tensorboard: bool = False) -> Run:
    return Run(folder, stop_after=stop_after, tensorboard=tensorboard)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    path = tmp_path / "run"
    with opened_folder(path, CONFIGURATION.to_dict(), resume=False):
        return path


def test_a_new_folder_holds_configuration_and_versions(folder: Path) -> None:
    written = json.loads((folder / CONFIG).read_text())
    assert BCConfig.from_dict(written) == CONFIGURATION
    assert json.loads((folder / RECORD).read_text())["versions"]["torch"] == torch.__version__


def test_metrics_after_the_checkpoint_are_dropped(folder: Path) -> None:
    with opened(folder) as run:
        run.log(1, 9, loss=0.5)
        run.checkpoint(1, {"a": torch.ones(2)})
        run.log(2, 9, loss=0.25)
    with (folder / METRICS).open("a") as file:
        file.write('{"step": 3, "lo')
    assert [line["step"] for line in read_metrics(folder)] == [1, 2]
    with opened(folder) as run:
        assert run.step == 1
        assert run.saved is not None
        assert torch.equal(run.saved["a"], torch.ones(2))
        run.log(2, 9, loss=math.nan)
    assert read_metrics(folder) == [{"step": 1, "loss": 0.5}, {"step": 2, "loss": None}]


def test_what_is_not_finite_never_becomes_a_checkpoint(folder: Path) -> None:
    with opened(folder) as run:
        run.checkpoint(5, {"a": torch.ones(2)})
        for bad in ({"a": torch.tensor([1.0, math.inf])}, {"b": [{"c": math.nan}]}):
            with pytest.raises(DivergedError, match=r"at step 6 .*keeps the checkpoint of step 5"):
                run.checkpoint(6, bad)
    with opened(folder) as run:
        assert run.step == 5


def test_facts_may_not_change(folder: Path) -> None:
    with opened(folder) as run:
        run.describe(demonstrations=["a"])
    with opened(folder) as run:
        run.describe(demonstrations=["a"])
        with pytest.raises(RunFolderError, match=r"other demonstrations; expected \['a'\], found"):
            run.describe(demonstrations=["b"])


def test_precision_and_threads_are_chosen_once_and_kept(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with restored_threads():
        with opened(folder) as run:
            chosen = run.compute("cpu", "auto", 0)
        assert chosen.threads == torch.get_num_threads()
        monkeypatch.setattr("magical.learning.running.devices.has_bfloat16", lambda _: None)
        torch.set_num_threads(chosen.threads + 1)
        with opened(folder) as run:
            assert run.compute("cpu", "auto", 0) == chosen
        assert torch.get_num_threads() == chosen.threads


def test_checkpoints_are_due_by_number_or_by_time(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = 100.0
    monkeypatch.setattr("magical.learning.running.run.time.monotonic", lambda: now)
    with opened(folder) as run:
        assert [run.checkpoint_is_due(step, 3) for step in (2, 3, 4, 6)] == [False, True] * 2
        assert not run.checkpoint_is_due(3, 0)
        now += CHECKPOINT_SECONDS
        assert run.checkpoint_is_due(4, 0)
        run.checkpoint(4, {})
        assert not run.checkpoint_is_due(5, 0)


def test_stop_after_counts_from_the_checkpoint(folder: Path) -> None:
    with opened(folder, stop_after=3) as run:
        assert [run.stops(step) for step in (2, 3)] == [False, True]
        run.checkpoint(3, {})
    with opened(folder, stop_after=3) as run:
        assert [run.stops(step) for step in (5, 6)] == [False, True]


def test_tensorboard_gets_the_metrics(folder: Path) -> None:
    pytest.importorskip("tensorboard")
    with opened(folder, tensorboard=True) as run:
        run.log(1, 9, loss=0.5)
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    events = EventAccumulator(str(folder / "tensorboard"))
    events.Reload()
    assert [(event.step, event.value) for event in events.Scalars("loss")] == [(1, 0.5)]


def test_configurations_are_checked() -> None:
    def made(**fields: object) -> BCConfig:
        return BCConfig.preset("quick", **{"tasks": "MoveToCorner", "demos": "d", **fields})

    assert made().tasks == ("MoveToCorner",)
    assert made().network == "narrow"
    for name, value in (("batches", 0), ("learning_rate", -1.0), ("seed", -1), ("num_demos", 0)):
        with pytest.raises(InvalidConfigError, match=name):
            made(**{name: value})
    for name in ("network", "device", "precision", "optimizer", "augment", "observation"):
        with pytest.raises(UnknownNameError, match="'odd'"):
            made(**{name: "odd"})
    with pytest.raises(InvalidConfigError, match="each task once"):
        made(tasks=("MoveToCorner", "MoveToCorner"))
    with pytest.raises(UnknownNameError, match="preset 'slow'"):
        BCConfig.preset("slow", tasks=("MoveToCorner",), demos="d")
    with pytest.raises(InvalidConfigError, match="configuration of bc"):
        BCConfig.from_dict({"algorithm": "bc", "tasks": ["MoveToCorner"]})


def test_options_follow_the_fields() -> None:
    found = {option.flag: option for option in options(BCConfig)}
    assert found["--tasks"].several
    assert found["--tasks"].required
    assert found["--batch-size"].kind is int
    assert found["--learning-rate"].default == 1e-3
    assert found["--anneal"].kind is bool
    assert found["--optimizer"].choices == ("sgd", "adam")
    assert (found["--batch-size"].metavar, found["--learning-rate"].metavar) == ("N", "X")


def test_every_field_with_choices_accepts_these_alone() -> None:
    for option in options(BCConfig):
        for value in option.choices:
            fields: dict[str, Any] = {option.name: value, "augment": "none"}
            made = BCConfig(tasks=("MoveToCorner",), demos="d", **fields)
            assert getattr(made, option.name) == value
        if option.choices:
            with pytest.raises(UnknownNameError, match=f"{option.name} 'odd' is unknown"):
                BCConfig.preset("paper", tasks=("MoveToCorner",), demos="d", **{option.name: "odd"})


def test_learning_is_imported_without_pytorch() -> None:
    code = (
        "import sys, magical.learning, magical.learning.config, magical.learning.networks; "
        "magical.learning.algorithm_names(); sys.exit('torch' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0
