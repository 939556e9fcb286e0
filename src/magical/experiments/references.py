"""The policies that a plan evaluates beside its methods: nothing is trained."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from magical.errors import ScoresError
from magical.evaluation import Entry, Evaluation, load_policy, read_entry
from magical.evaluation.rollouts import roll_out
from magical.experiments.entries import evaluation_details

REFERENCES = "references"  # in a results folder: a folder for each policy and task


def evaluate_reference(
    name: str,
    evaluation: Evaluation,
    results: Path,
    workers: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> None:
    """Evaluate a built-in policy on a task, unless the results folder has its entry already.

    `progress` is called after some rollouts, with their number.
    """
    policy = load_policy(name)
    folder = results / REFERENCES / f"{name}-{evaluation.env_ids[0].task}"
    details = evaluation_details(name, folder)
    entry = Entry.of(policy, evaluation, method=name, details=details)
    if not _is_entry_of(folder, entry, evaluation):
        scores = roll_out(policy, evaluation, workers=workers, progress=progress)
        replace(entry, scores=scores).write(folder)


def _is_entry_of(folder: Path, entry: Entry, evaluation: Evaluation) -> bool:
    """Whether a folder holds the entry of this evaluation, by this version of the package."""
    try:
        found = read_entry(folder)
    except ScoresError:
        return False
    rollouts = len(found.scores) == evaluation.rollouts * len(evaluation.env_ids)
    ids = {row.env_id for row in found.scores} == set(evaluation.env_ids)
    return rollouts and ids and replace(found, scores=(), details=entry.details) == entry
