"""MLflow, in the experiment named by MLFLOW_EXPERIMENT_NAME (default: magical)."""

import os
from collections.abc import Iterator
from contextlib import contextmanager

from magical.extras import library
from magical.learning.trackers import Log, TrackedRun, Tracker

_ID = "magical.run"  # the tag by which a resumed run is found: MLflow chooses its own ids


@contextmanager
def _opened(run: TrackedRun) -> Iterator[Log]:
    mlflow = library("mlflow", "tracker mlflow")
    name = os.environ.get("MLFLOW_EXPERIMENT_NAME", "magical")
    experiment = mlflow.set_experiment(name).experiment_id
    client = mlflow.MlflowClient()
    found = client.search_runs([experiment], f"tags.`{_ID}` = '{run.id}'", max_results=1)
    session = mlflow.start_run(
        run_id=found[0].info.run_id if found else None,
        experiment_id=experiment,
        run_name=run.name,
        tags={_ID: run.id},
    )
    with session:
        if not found:
            mlflow.log_params(dict(run.config))
        yield lambda step, metrics: mlflow.log_metrics(dict(metrics), step=step)


TRACKER = Tracker(_opened)
