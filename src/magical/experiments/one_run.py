"""One run of a plan: training, evaluation, final record. Executed in a process of its own."""

import dataclasses
import os
import time
import traceback
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from magical import __version__
from magical.errors import CheckpointError, MagicalError
from magical.evaluation import Entry, environments, evaluate
from magical.evaluation.entry import ENTRY_FILE, POLICY, SCORES_FILE, THREADS
from magical.evaluation.policy import is_privileged
from magical.evaluation.rollouts import observation_for
from magical.experiments.plan import Evaluation, PlannedRun
from magical.experiments.results import DONE, FAILED, RESULT, Outcome
from magical.files import is_out_of_space, remove_partial_files
from magical.learning import Config, TrainResult, is_run, load_policy, train
from magical.learning.config import ImitationConfig
from magical.learning.description import training_details
from magical.messages import printable
from magical.runs.folder import versions, write_json
from magical.runs.machine import machine, source_commit
from magical.runs.provenance import provenance

MAX_ERROR = 2_000  # characters of a recorded message
MAX_TRACEBACK = 20_000  # and of a traceback, whose end says most


def finish(run: PlannedRun, folder: Path, demos: Path | None) -> Outcome:
    """Train, or resume from the newest checkpoint; evaluate; write `result.json` last.

    An error is recorded in `result.json` and returned, not raised.

    Args:
        run: the run.
        folder: its folder, new or left by an earlier attempt.
        demos: the dataset to learn from.
    """
    start = time.perf_counter()
    source_commit()  # now: the source may change while the run is in progress
    try:
        (folder / RESULT).unlink(missing_ok=True)
        remove_partial_files(folder, RESULT, SCORES_FILE, ENTRY_FILE)
        seconds = _train_and_evaluate(run, folder, demos)
        if seconds is None:
            return Outcome("interrupted", time.perf_counter() - start)
        write_result(run, folder, state=DONE, seconds=seconds)
    except Exception as error:
        if is_out_of_space(error):
            return Outcome("no space", time.perf_counter() - start, str(error))
        return Outcome("failed", time.perf_counter() - start, record_failure(run, folder, error))
    return Outcome("done", time.perf_counter() - start)


def record_failure(run: PlannedRun, folder: Path, error: Exception) -> str:
    """Write a failed run's final record; returns the message in it."""
    kind = "" if isinstance(error, MagicalError) else f"{type(error).__name__}: "
    message = printable(f"{kind}{error}", MAX_ERROR)
    text = "".join(traceback.format_exception(error))[-MAX_TRACEBACK:]
    write_result(run, folder, state=FAILED, error=message, traceback=text)
    return message


def write_result(run: PlannedRun, folder: Path, **result: Any) -> None:
    """Write a run's final record."""
    facts = {
        "method": run.method,
        "tasks": list(run.tasks),
        "seed": run.seed,
        "preset": run.preset,
        "identity": run.identity,
        "settings": run.settings(),
        "finished": f"{datetime.now(UTC):%FT%TZ}",
        "versions": versions(),
        "commit": source_commit(),
        "machine": machine(),
    }
    write_json(folder / RESULT, {**result, **facts})


def _train_and_evaluate(
    run: PlannedRun, folder: Path, demos: Path | None
) -> Mapping[str, float] | None:
    """The seconds of training and evaluation; `None` if training was interrupted."""
    config = run.config
    if demos is not None and isinstance(config, ImitationConfig):
        config = dataclasses.replace(config, demos=str(demos))
    start = time.perf_counter()
    if _train(config, folder).interrupted:
        return None
    trained = time.perf_counter()
    _evaluate(run, folder)
    return {"training": trained - start, "evaluation": time.perf_counter() - trained}


def _train(config: Config, folder: Path) -> TrainResult:
    """Start the run, or resume it; from its previous checkpoint if the newest is damaged."""
    resume = is_run(folder)
    try:
        return train(config, folder, resume=resume)
    except CheckpointError:
        return train(config, folder, resume=resume, previous_checkpoint=resume)


def _evaluate(run: PlannedRun, folder: Path) -> None:
    """Evaluate the trained policy as the plan says."""
    evaluate_run(run, folder, folder, run.evaluation)


def evaluate_run(run: PlannedRun, folder: Path, out: Path, evaluation: Evaluation) -> None:
    """Evaluate a run's trained policy, and write `scores.csv` and `entry.json`.

    Args:
        run: of a plan.
        folder: its folder, with a checkpoint.
        out: where the files are written: the folder, or one in it.
        evaluation: how; it may differ from the run's.
    """
    from magical.learning.running.devices import cpu_threads

    policy = load_policy(folder, device=run.config.device)
    horizon = evaluation.horizon_of(run.tasks)
    with cpu_threads(run.config.threads):
        scores = evaluate(
            policy,
            environments(run.tasks, evaluation.variants or None),
            rollouts=evaluation.rollouts,
            horizon=horizon,
            nudge=evaluation.nudge,
            workers=0 if run.config.threads == 1 else run.config.threads,
        )
    entry = Entry(
        method=run.method,
        scores=scores,
        observation=str(observation_for(policy)),
        privileged=is_privileged(policy),
        horizon="appendix" if horizon is None else str(horizon),
        nudge=evaluation.nudge,
        version=__version__,
        details={**_details(run), POLICY: os.path.relpath(folder, out)},
    )
    entry.write(out)


def _details(run: PlannedRun) -> dict[str, Any]:
    """How the run was made, for `entry.json`; all settings are in `result.json`."""
    details = {
        THREADS: run.config.threads,
        "preset": run.preset,
        **training_details(run.config),
        **provenance(),
    }
    if isinstance(run.config, ImitationConfig):
        details["demonstrations"] = f"{run.config.num_demos} of each task ({run.source})"
    return details
