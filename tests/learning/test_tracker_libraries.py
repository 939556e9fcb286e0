"""Trackers with their real libraries, offline; each is skipped where its library is missing."""

from pathlib import Path

import pytest

from magical.learning.trackers import TrackedRun, opened_trackers
from magical.runs.folder import opened_folder

pytestmark = pytest.mark.filterwarnings("default")  # the libraries' own


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A run folder; the working folder is another."""
    path = tmp_path / "run"
    with opened_folder(path, {"algorithm": "bc", "seed": 3}, resume=False):
        pass
    monkeypatch.chdir(tmp_path)
    return path


def log_twice(name: str, folder: Path) -> None:
    """Log as a run does that is interrupted after step 2 and resumed there."""
    for step, metrics in ((1, {"loss": 0.5}), (2, {"loss": 0.25})):
        with opened_trackers([name], folder, step - 1) as log:
            log(step, metrics)


def test_wandb(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("wandb")
    monkeypatch.setenv("WANDB_MODE", "offline")
    log_twice("wandb", folder)
    run = TrackedRun.of(folder, 0)
    files = list((tmp_path / "wandb").glob(f"offline-run-*/run-{run.id}.wandb"))
    assert files
    assert any(b"loss" in file.read_bytes() for file in files)


def test_trackio(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TRACKIO_DIR", str(tmp_path / "trackio"))
    pytest.importorskip("trackio")
    from trackio.sqlite_storage import SQLiteStorage

    log_twice("trackio", folder)
    (run,) = SQLiteStorage.get_runs("magical")
    assert run == f"run-{TrackedRun.of(folder, 0).id[:8]}"
    logs = SQLiteStorage.get_logs("magical", run)
    assert [(row["step"], row["loss"]) for row in logs] == [(1, 0.5), (2, 0.25)]


def test_mlflow(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mlflow = pytest.importorskip("mlflow")
    monkeypatch.setenv("MLFLOW_ALLOW_FILE_STORE", "true")
    mlflow.set_tracking_uri((tmp_path / "mlruns").as_uri())
    log_twice("mlflow", folder)
    client = mlflow.MlflowClient()
    experiment = client.get_experiment_by_name("magical").experiment_id
    (run,) = client.search_runs([experiment])
    assert run.data.params == {"algorithm": "bc", "seed": "3"}
    history = client.get_metric_history(run.info.run_id, "loss")
    assert [(one.step, one.value) for one in history] == [(1, 0.5), (2, 0.25)]
