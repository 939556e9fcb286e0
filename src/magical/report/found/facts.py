"""How every run was made: settings, versions, machine, links."""

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from operator import attrgetter
from pathlib import Path
from typing import Any
from urllib.parse import quote

from magical.evaluation.entry import ENTRY_FILE, SCORES_FILE
from magical.report.found.rows import by_row
from magical.report.found.search import Result
from magical.runs.folder import CONFIG, CURVES, METRICS, RECORD

FILES = (SCORES_FILE, ENTRY_FILE)  # of an entry
RUN_FILES = (CONFIG, RECORD, METRICS, CURVES)
MAX_TEXT = 300  # characters shown of a value

Facts = Mapping[str, str]  # settings, versions and everything else that is recorded, as text


@dataclass(frozen=True, slots=True)
class RunFacts:
    """One run: how it differs from the other runs of its method, and links to its files."""

    folder: str
    facts: Facts
    links: Mapping[str, str] = field(default_factory=dict)  # addresses relative to the page


@dataclass(frozen=True, slots=True)
class MethodFacts:
    """One method: what all its runs have in common, and each run."""

    method: str
    common: Facts
    runs: Sequence[RunFacts]


def describe_methods(results: Iterable[Result], page: Path | None = None) -> list[MethodFacts]:
    """How each method's runs were made; if the page's path is given, with links to their files."""
    rows = by_row(results, attrgetter("entry"))
    return [_describe(label, runs, page) for label, runs in rows.items()]


def _describe(method: str, results: Sequence[Result], page: Path | None) -> MethodFacts:
    facts = [_facts(result) for result in results]
    common = {
        name: value
        for name, value in facts[0].items()
        if all(other.get(name) == value for other in facts)
    }
    runs = [
        RunFacts(
            str(result.folder),
            {name: value for name, value in own.items() if name not in common},
            {} if page is None else dict(_links(result, page)),
        )
        for result, own in zip(results, facts, strict=True)
    ]
    return MethodFacts(method, common, runs)


def _facts(result: Result) -> dict[str, str]:
    """Everything that is recorded about a run, flattened, as text."""
    entry, record = result.entry, dict(result.record)
    demonstrations = record.pop("demonstrations", [])
    used = len(demonstrations) if isinstance(demonstrations, list) else 0
    groups: Mapping[str, Any] = {
        "tasks": result.tasks,
        "observation": entry.observation,
        "privileged": entry.privileged or "",
        "horizon": entry.horizon,
        "nudge": entry.nudge,
        "seeds of rollouts": entry.seed,
        "evaluated by version": entry.version,
        "": entry.details,
        "training": result.config,
        "recorded": record,
        "demonstrations used": used or "",
    }
    return {name: text for name, value in groups.items() for name, text in _flat(name, value)}


def _flat(name: str, value: Any) -> Iterator[tuple[str, str]]:
    """Names and texts of a value; mappings are flattened, and empty values are left out."""
    if isinstance(value, Mapping):
        for key, item in value.items():
            yield from _flat(f"{name}: {key}" if name else str(key), item)
    elif isinstance(value, list | tuple):
        yield from _flat(name, ", ".join(map(str, value)))
    elif value != "" and value is not None:
        text = str(value)
        yield name, text if len(text) <= MAX_TEXT else f"{text[:MAX_TEXT]} ..."


def _links(result: Result, page: Path) -> Iterator[tuple[str, str]]:
    """The files of an entry and of its training run, by name."""
    files = [result.folder / name for name in FILES]
    run = result.run
    if run and (run.is_relative_to(result.folder) or result.folder.is_relative_to(run)):
        files += [run / name for name in RUN_FILES]
    for file in files:
        if file.is_file():
            relative = os.path.relpath(file.absolute(), page.absolute().parent)
            yield file.name, quote(os.fsencode(Path(relative).as_posix()))
