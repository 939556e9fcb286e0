"""One run of a plan: training, evaluation, final record. Executed in a process of its own."""

import time
import traceback
from collections.abc import Mapping
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from magical.errors import MagicalError, ScoresError
from magical.evaluation import BUILT_IN, Entry, read_entry
from magical.evaluation.entry import record_of
from magical.evaluation.protocol import Evaluation
from magical.evaluation.rollouts import modules_for, roll_out
from magical.experiments.plan import PlannedRun
from magical.experiments.results import DONE, FAILED, Outcome
from magical.files import is_out_of_space
from magical.learning import is_run, load_policy, train
from magical.learning.algorithms import modules_of
from magical.learning.config import DemonstrationSettings
from magical.messages import printable
from magical.runs.folder import write_json
from magical.runs.machine import provenance, source_commit
from magical.runs.plan import REFERENCES, RESULT

MAX_ERROR = 2_000  # characters of a recorded message
MAX_TRACEBACK = 20_000  # and of a traceback, whose end is kept


def modules_of_run(run: PlannedRun) -> list[str]:
    """The modules that a process must import before it calls `finish`."""
    return [*modules_of(run.config), *modules_for(None, run.tasks)]


def finish(run: PlannedRun, folder: Path, demos: Path | None) -> Outcome:
    """Train on the dataset `demos`, or resume; evaluate; write `result.json` last.

    An error is recorded in `result.json` and returned, not raised; if no space is left, it is only
    returned.
    """
    start = time.perf_counter()
    source_commit()  # now: the source may change while the run is in progress
    try:
        (folder / RESULT).unlink(missing_ok=True)
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
        **provenance(),
    }
    write_json(folder / RESULT, {**result, **facts})


def _train_and_evaluate(
    run: PlannedRun, folder: Path, demos: Path | None
) -> Mapping[str, float] | None:
    """The seconds of training and evaluation; `None` if training was interrupted."""
    config = run.config
    if demos is not None and config.part(DemonstrationSettings):
        config = config.replace(demos=str(demos))
    start = time.perf_counter()
    resume = is_run(folder)
    result = train(config, folder, resume=resume)
    if result.interrupted:
        return None
    trained = time.perf_counter()
    evaluate_run(run, folder, folder, run.evaluation)
    return {"training": trained - start, "evaluation": time.perf_counter() - trained}


def evaluate_run(run: PlannedRun, folder: Path, out: Path, evaluation: Evaluation) -> None:
    """Evaluate a run's trained policy, and write `scores.csv` and `entry.json`.

    Args:
        run: the run of a plan.
        folder: its folder, with a checkpoint.
        out: where the files are written: the folder, or a subfolder.
        evaluation: how the policy is evaluated; it may differ from the run's own evaluation.
    """
    from magical.learning.running.devices import cpu_threads

    policy = load_policy(folder, device=run.config.device)
    with cpu_threads(run.config.threads):
        workers = 0 if run.config.threads == 1 else run.config.threads
        scores = roll_out(policy, evaluation, workers=workers)
        record = replace(record_of(policy, str(folder), out), preset=run.preset)
    if run.source.kind:  # all settings are in `result.json`
        whose = f"{record.demonstrations} ({run.source})"
        record = replace(record, demonstrations=whose)
    Entry.of(policy, evaluation, method=run.method, scores=scores, record=record).write(out)


def reference_folder(reference: tuple[str, Evaluation]) -> str:
    """The name of the folder of a built-in policy's entry on a task."""
    name, evaluation = reference
    return f"{name}-{evaluation.env_ids[0].task}"


def evaluate_reference(reference: tuple[str, Evaluation], results: Path) -> None:
    """Evaluate a built-in policy on a task, unless the results folder has its entry already."""
    name, evaluation = reference
    policy = BUILT_IN[name]()
    folder = results / REFERENCES / reference_folder(reference)
    record = record_of(policy, name, folder)
    entry = Entry.of(policy, evaluation, method=name, record=record)
    if not _is_entry_of(folder, entry, evaluation):
        replace(entry, scores=roll_out(policy, evaluation, workers=0)).write(folder)


def _is_entry_of(folder: Path, entry: Entry, evaluation: Evaluation) -> bool:
    """Whether a folder holds the entry of this evaluation, by this version of the package."""
    try:
        found = read_entry(folder)
    except ScoresError:
        return False
    return replace(found, scores=(), record=entry.record) == entry
