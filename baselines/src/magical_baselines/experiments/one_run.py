"""One run of a plan: training, evaluation, final record; as a program, in a process of its own."""

import errno
import os
import pickle
import sys
import time
import traceback
from contextlib import suppress
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from threading import Thread
from typing import Any

from filelock import FileLock

from magical.errors import MagicalError, ScoresError
from magical.evaluation import BUILT_IN, Entry, read_entry
from magical.evaluation.entry import record_of
from magical.evaluation.protocol import Evaluation
from magical.evaluation.rollouts import modules_for, roll_out
from magical.files import is_out_of_space
from magical.messages import printable
from magical.runs.folder import write_json
from magical.runs.machine import provenance, source_commit
from magical.runs.plan import RESULT
from magical.tasks import load_tasks
from magical_baselines import is_run, load_policy, train
from magical_baselines.compute import cpu_threads
from magical_baselines.config import DemonstrationConfig, modules_of
from magical_baselines.experiments.plan import PlannedReference, PlannedRun
from magical_baselines.experiments.status import DONE, FAILED, lock_of

MAX_ERROR, MAX_TRACEBACK = 2_000, 20_000  # characters that are recorded
NO_SPACE = errno.ENOSPC  # exit status of a process: the disk is full
PATIENCE = 30.0  # seconds for a run to end whose plan was killed

Planned = PlannedRun | PlannedReference


def modules_needed(work: Planned) -> list[str]:
    """The users' modules that a process must import before it calls `finish`."""
    if isinstance(work, PlannedRun):
        return [*modules_of(work.config), *modules_for(None, work.tasks)]
    return modules_for(BUILT_IN[work.policy](), list(work.evaluation.by_task))


def finish(work: Planned, folder: Path, demos: Path | None = None) -> None:
    """Train on the dataset `demos`, or resume; evaluate; write `result.json` last.

    Without `result.json`, the run was interrupted by Ctrl-C or SIGTERM, and has left a checkpoint.
    An error is recorded there, and not raised, but for a full disk. Of a reference policy there is
    only the evaluation, and errors are raised.
    """
    if isinstance(work, PlannedReference):
        evaluate_reference(work, folder)
        return
    folder.parent.mkdir(parents=True, exist_ok=True)
    with FileLock(lock_of(folder), timeout=PATIENCE):
        source_commit()  # now: the source may change while the run is in progress
        (folder / RESULT).unlink(missing_ok=True)
        try:
            config, start = work.config, time.perf_counter()
            if demos and isinstance(config, DemonstrationConfig):
                config = config.replace(demos=str(demos))
            if train(config, folder, resume=is_run(folder)).interrupted:
                return
            trained = time.perf_counter()
            evaluate_run(work, folder, folder, work.evaluation)
            times = {"training": trained - start, "evaluation": time.perf_counter() - trained}
            write_result(work, folder, state=DONE, seconds=times)
        except Exception as error:
            if is_out_of_space(error):
                raise
            write_failure(work, folder, error)


def write_failure(run: PlannedRun, folder: Path, error: BaseException) -> None:
    """Write the final record of a run that failed."""
    kind = "" if isinstance(error, MagicalError) else f"{type(error).__name__}: "
    text = "".join(traceback.format_exception(error))[-MAX_TRACEBACK:]
    message = printable(f"{kind}{error}", MAX_ERROR)
    write_result(run, folder, state=FAILED, error=message, traceback=text)


def write_result(run: PlannedRun, folder: Path, **result: Any) -> None:
    """Write a run's final record."""
    result |= {"method": run.method, "tasks": list(run.tasks), "seed": run.seed}
    result |= {"preset": run.preset, "settings": run.settings()}
    result["finished"] = f"{datetime.now(UTC):%FT%TZ}"
    write_json(folder / RESULT, {**result, **provenance()})


def evaluate_run(run: PlannedRun, folder: Path, out: Path, evaluation: Evaluation) -> None:
    """Evaluate the trained policy in a run's folder; write `scores.csv` and `entry.json` to `out`.

    `evaluation` may differ from the run's own.
    """
    policy = load_policy(folder, device=run.config.device)
    with cpu_threads(run.config.threads):
        workers = 0 if run.config.threads == 1 else run.config.threads
        scores = roll_out(policy, evaluation, workers=workers)
        record = replace(record_of(policy, str(folder), out), preset=run.preset)
    if run.source.kind:  # all settings are in `result.json`
        record = replace(record, demonstrations=f"{record.demonstrations} ({run.source})")
    Entry.of(policy, evaluation, method=run.method, scores=scores, record=record).write(out)


def evaluate_reference(reference: PlannedReference, folder: Path) -> None:
    """Evaluate a built-in policy on a task, unless the folder has its entry already."""
    name, evaluation = reference.policy, reference.evaluation
    policy = BUILT_IN[name]()
    record = record_of(policy, name, folder)
    entry = Entry.of(policy, evaluation, method=name, record=record)
    with suppress(ScoresError):
        found = read_entry(folder)
        same = replace(found, scores=(), record=record) == entry
        if same and len(found.scores) == evaluation.rollouts * len(evaluation.env_ids):
            return
    replace(entry, scores=roll_out(policy, evaluation, workers=0)).write(folder)


def main() -> None:
    """Finish what the parent process has pickled to standard input, and end when it does."""
    load_tasks(pickle.load(sys.stdin.buffer))  # noqa: S301  (our own parent's)
    work, folder, demos = pickle.load(sys.stdin.buffer)  # noqa: S301

    def end_with_parent() -> None:
        os.read(sys.stdin.fileno(), 1)  # it writes no more, but its end closes the pipe
        os._exit(1)

    Thread(target=end_with_parent, daemon=True).start()
    try:
        finish(work, folder, demos)
    except Exception as error:
        if is_out_of_space(error):
            sys.exit(NO_SPACE)
        raise


if __name__ == "__main__":
    main()
