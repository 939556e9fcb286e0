"""Run folders being written: configuration, resuming, locks, metrics."""

import math
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from magical.errors import RunFolderError
from magical.files import LOCK
from magical.runs import CONFIG, METRICS, RECORD, is_run, read_json, read_metrics
from magical_baselines.run_folder import MetricsWriter, is_locked, opened_folder

CONFIGURATION: Mapping[str, Any] = {"algorithm": "bc", "demos": "demos", "seed": 0}


def open_once(path: Path, resume: bool = False, **changed: Any) -> None:
    with opened_folder(path, {**CONFIGURATION, **changed}, resume):
        pass


def write(folder: Path, step: int, *rows: tuple[int, float]) -> None:
    writer = MetricsWriter(folder, step)
    for number, loss in rows:
        writer.write(number, {"loss": loss})
    writer.close()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A run that has logged something."""
    path = tmp_path / "run"
    open_once(path)
    write(path, 0, (1, 0.5))
    return path


def test_a_new_folder_holds_configuration_and_versions(folder: Path, tmp_path: Path) -> None:
    assert is_run(folder)
    assert not is_run(tmp_path)
    assert read_json(folder / CONFIG) == CONFIGURATION
    assert {"magical", "python", "numpy"} <= read_json(folder / RECORD)["versions"].keys()


def test_a_run_is_continued_only_on_request_and_only_with_its_configuration(folder: Path) -> None:
    with pytest.raises(RunFolderError, match="holds this run already; add --resume"):
        open_once(folder)
    open_once(folder, resume=True, demos="elsewhere", workers=3, log_every=1)
    for resume in (False, True):
        with pytest.raises(RunFolderError, match="another configuration: seed 0 there, 1 asked"):
            open_once(folder, resume, seed=1)


def test_a_folder_without_a_run_is_refused_and_left_as_it_is(tmp_path: Path) -> None:
    with pytest.raises(RunFolderError, match="expected a run to resume, found none"):
        open_once(tmp_path / "none", resume=True)
    (tmp_path / "thesis.tex").touch()
    with pytest.raises(RunFolderError, match="expected a new or an empty folder"):
        open_once(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


def test_a_locked_folder_is_refused_to_another_but_can_be_read(folder: Path) -> None:
    with opened_folder(folder, CONFIGURATION, resume=True):
        with pytest.raises(RunFolderError, match="another process already trains"):
            open_once(folder, resume=True)
        assert read_json(folder / CONFIG) == CONFIGURATION


def test_what_is_written_is_read(tmp_path: Path) -> None:
    assert read_metrics(tmp_path) == []
    writer = MetricsWriter(tmp_path, 0)
    writer.write(1, {"loss": 0.12345678, "episodes": 3, "warning": "one action"})
    writer.write(2, {"loss": math.nan, "least": -math.inf})
    assert read_metrics(tmp_path) == [  # at once, before the file is closed
        {"step": 1, "loss": 0.123457, "episodes": 3, "warning": "one action"},
        {"step": 2, "loss": None, "least": None},
    ]
    writer.close()


def test_metrics_after_the_checkpoint_are_dropped(tmp_path: Path) -> None:
    write(tmp_path, 0, (1, 0.5), (2, 0.25), (3, 0.125))
    with (tmp_path / METRICS).open("a") as file:
        file.write('{"step": 4, "lo')
    assert [row["step"] for row in read_metrics(tmp_path)] == [1, 2, 3]
    write(tmp_path, 2, (3, 0.75))
    assert [row["loss"] for row in read_metrics(tmp_path)] == [0.5, 0.25, 0.75]


HOLD = """
import sys, pathlib
from magical_baselines.run_folder import opened_folder
with opened_folder(pathlib.Path(sys.argv[1]), {}, resume=False):
    print("held", flush=True)
    sys.stdin.read()
"""


def test_a_killed_process_holds_no_lock(tmp_path: Path) -> None:
    command = [sys.executable, "-c", HOLD, str(tmp_path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"held\n"
        assert is_locked(tmp_path / LOCK)
        process.kill()
        process.wait()
    assert not is_locked(tmp_path / LOCK)
