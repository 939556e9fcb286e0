"""Checks that entries follow the protocol (docs/protocol.md)."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from magical import __version__
from magical.errors import MagicalError
from magical.evaluation import Entry, by_variant
from magical.evaluation.policy import NO_OBSERVATION
from magical.evaluation.protocol import NUDGE, ROLLOUTS, SEED
from magical.grouping import group_by
from magical.observe import parse_spec
from magical.report.found.search import Found, Result, same_run
from magical.report.found.statements import stated_looks, unfinished
from magical.runs.sources import learned_from
from magical.tasks import get_task
from magical.tasks.axes import short_variant
from magical.tasks.horizons import APPENDIX


@dataclass(frozen=True, slots=True)
class Rejected:
    """An entry that is not ranked, and why."""

    folder: str
    method: str
    reasons: Sequence[str]


def by_reasons(rejected: Iterable[Rejected]) -> list[tuple[str, list[Rejected]]]:
    """The entries grouped by reasons, largest group first."""
    groups = group_by(rejected, lambda entry: "; ".join(entry.reasons))
    return sorted(groups.items(), key=lambda group: -len(group[1]))


def check_entries(found: Found) -> tuple[list[Result], list[Rejected]]:
    """The entries that can be ranked, and the others with the reasons why not."""
    rejected = [Rejected(str(item.folder), "", [item.reason]) for item in found.skipped]
    candidates = []
    for result in found.results:
        if reasons := [*faults(result.entry), *_misobserved(result)]:
            rejected.append(Rejected(str(result.folder), result.entry.method, reasons))
        else:
            candidates.append(result)
    accepted: list[Result] = []
    for result in candidates:
        if reasons := list(_conflicts(result, accepted)):
            rejected.append(Rejected(str(result.folder), result.entry.method, reasons))
        else:
            accepted.append(result)
    return accepted, rejected


def faults(entry: Entry) -> list[str]:
    """How a single entry violates the protocol; empty if it does not."""
    return [
        *_protocol_faults(entry),
        *_observation_faults(entry),
        *incompleteness(entry),
        *misstatements(entry, learned_from, stated_looks),
    ]


def _misobserved(result: Result) -> Iterator[str]:
    """A contradiction between the observation that an entry states and that of its run."""
    trained, stated = result.config.get("observation"), result.entry.observation
    if trained is not None and trained != stated:
        yield f"observation {stated or '(not stated)'}, but its run was trained on {trained}"


def incompleteness(entry: Entry) -> Iterator[str]:
    """Why an entry is not a complete evaluation by this version of the package."""
    if entry.seed != SEED:
        yield f"set {entry.seed} of fixed seeds, expected {SEED}: evaluate without --seed"
    rollouts = max(row.rollout for row in entry.scores) + 1
    if rollouts != ROLLOUTS:
        yield f"{rollouts} rollouts of each environment, expected {ROLLOUTS}"
    for task, cells in by_variant(entry.scores).items():
        names = map(short_variant, get_task(task).variants)
        if absent := [name for name in names if name not in cells]:
            yield f"{task} without {', '.join(absent)}: all variants of a task are needed"
    if done := unfinished(entry.details):
        yield f"its training run is unfinished ({done}): train it to its end and evaluate again"
    if _series(entry.version) != _series(__version__):
        yield (
            f"made by version {entry.version or '(not stated)'} of this package, this is "
            f"{__version__}: scores may differ; evaluate again"
        )


def misstatements(entry: Entry, *readers: Callable[[Mapping[str, Any]], object]) -> Iterator[str]:
    """The `ValueError` messages that readers of an entry's details raise."""
    for read in readers:
        try:
            read(entry.details)
        except ValueError as error:
            yield str(error)


def _protocol_faults(entry: Entry) -> Iterator[str]:
    if entry.horizon != APPENDIX:
        yield f"horizon {entry.horizon}, expected {APPENDIX}: evaluate without --horizon"
    if entry.nudge != NUDGE:
        yield f"nudge {entry.nudge:g}, expected {NUDGE:g}: evaluate with --noise {NUDGE:g}"


def _observation_faults(entry: Entry) -> Iterator[str]:
    """Why an entry that does not say that it is privileged may have observed true states."""
    if entry.privileged or entry.observation == NO_OBSERVATION:
        return
    try:
        spec = parse_spec(entry.observation, entry.scores[0].env_id.task_spec)
    except MagicalError as error:
        yield f"{error}; only images are not privileged: expected privileged to be true"
    else:
        if spec.num_images == 0:
            yield f"{entry.observation} has no images: expected privileged to be true"


def _series(version: str) -> str:
    """The part of a version that scores depend on: its first number, before 1.0 its first two.

    Version 0.1 counts as 1: nothing that scores depend on changed between 0.1 and 1.0.
    """
    first, second, *_ = [*version.split("."), ""]
    series = f"{first}.{second}" if first == "0" else first
    return "1" if series == "0.1" else series


def _conflicts(result: Result, accepted: Sequence[Result]) -> Iterator[str]:
    """Why a result cannot be a run of its method, given those accepted before."""
    entry = result.entry
    if other := same_run(result, accepted):
        yield (
            f"the same run as {other.folder}, judging by its scores or its training_seed: each run "
            "counts only once"
        )
        return
    # All accepted runs of a method agree, so the first one is enough.
    first = next((run for run in accepted if run.entry.method == entry.method), None)
    if first and (found := mismatch(entry, first)):
        yield found


def mismatch(entry: Entry, other: Result) -> str:
    """How an entry's observation or sources differ from a run of its method; empty if equal."""
    for what, value, expected in (
        ("observation", entry.observation, other.entry.observation),
        ("privileged", entry.privileged, other.entry.privileged),
        ("action space", entry.evaluated.action_space, other.entry.evaluated.action_space),
        ("learned from", _sources(entry), _sources(other.entry)),
    ):
        if value != expected:
            return f"{what}: {value}, but {other.folder} of the same method has {expected}"
    return ""


def _sources(entry: Entry) -> str:
    try:
        return ", ".join(learned_from(entry.details)) or "nothing"
    except ValueError:
        return "sources that are not stated"
