"""Which scores are missing: method x task x variant x seed."""

from collections.abc import Iterator, Sequence
from operator import attrgetter

from magical.evaluation import by_variant
from magical.report.found.rows import by_row
from magical.report.found.search import Found, Result
from magical.tasks import get_task
from magical.tasks.axes import short_variant

Missing = tuple[str, str, str]  # method, task, and which of its scores are missing


def find_missing(found: Found) -> list[Missing]:
    """All scores that are missing.

    With a plan, these are its runs without scores. Without one, a method is expected to have every
    task that another method has, with as many runs and, if known, the same training seeds, and a
    training run is expected to have an entry. A run is expected to have all variants of its tasks.
    """
    variants = _variants(found.results)
    if found.planned is not None:
        runs = (
            (run.method, ", ".join(run.tasks), f"seed {run.seed}: {why}")
            for run, why in found.planned
        )
        return [*runs, *variants]
    folders = (
        ("–", "–", f"{folder}: a training run without an entry") for folder in found.not_evaluated
    )
    return [*_unplanned(found.results), *variants, *folders]


def _unplanned(results: Sequence[Result]) -> Iterator[Missing]:
    rows = by_row(results, attrgetter("entry"))
    for task in dict.fromkeys(task for result in results for task in result.tasks):
        on_task = [result for result in results if task in result.tasks]
        groups = {name: [run for run in row if task in run.tasks] for name, row in rows.items()}
        most = max(map(len, groups.values()))
        seeds = {run.seed for run in on_task}
        methods = {run.entry.method for run in on_task}
        for name, group in groups.items():
            if not group:
                if rows[name][0].entry.method not in methods:  # in any of the method's rows
                    yield name, task, "no run"
            elif len(group) < most:
                absent = _absent(seeds, {run.seed for run in group})
                yield name, task, f"{len(group)} of {most} runs{absent}"


def _absent(seeds: set[int | None], present: set[int | None]) -> str:
    """Text that names the missing seeds; empty if not all seeds that are present are known."""
    missing = sorted(seed for seed in seeds - present if seed is not None)
    return f": no seed {', '.join(map(str, missing))}" if missing and None not in present else ""


def _variants(results: Sequence[Result]) -> Iterator[Missing]:
    """The variants on which runs were not evaluated; runs that lack the same ones are grouped."""
    groups: dict[tuple[str, str, str], list[Result]] = {}
    rows = by_row(results, attrgetter("entry"))
    for label, result in ((label, result) for label, row in rows.items() for result in row):
        for task, cells in by_variant(result.entry.scores).items():
            names = map(short_variant, get_task(task).variants)
            if absent := ", ".join(name for name in names if name not in cells):
                groups.setdefault((label, task, absent), []).append(result)
    for (method, task, absent), runs in groups.items():
        yield method, task, f"{_named(runs)}: not evaluated on {absent}"


def _named(runs: Sequence[Result]) -> str:
    """The names of runs: their seeds, or their folders if a seed is not known."""
    seeds = [run.seed for run in runs]
    if None in seeds:
        return ", ".join(run.folder.name for run in runs)
    return f"seed{'s' if len(seeds) > 1 else ''} {', '.join(map(str, seeds))}"
