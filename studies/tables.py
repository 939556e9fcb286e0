"""Rows and cells of the studies' tables."""

from collections.abc import Iterator, Sequence
from operator import attrgetter

from magical.grouping import group_by
from magical.report.table import interval_text, means_apart, signed
from magical.tasks.axes import SHORT_VARIANTS, short_variant
from studies.plan_results import NOT_RUN
from studies.published_tables.agreement import Agreement
from studies.published_tables.cells import LIMITS, ComparedCell, distance_text
from studies.published_tables.claims import Finding, order, verdict
from studies.published_tables.rows import MethodRuns
from tools.readme_tables import table

MAX_LISTED = 5  # names in a list; the rest are counted


def claim_row(finding: Finding, together: Finding) -> Iterator[str]:
    """A claim, its intervals and verdict, and the verdict when all claims are tested jointly."""
    claim, ours = finding.claim, finding.ours
    yield f"{claim.text}: {claim.formula}"
    yield finding.part
    yield from ("–" if i is None else signed(i) for i in (finding.published, finding.same))
    yield NOT_RUN if ours is None else f"{signed(ours)}, {task_names(finding.tasks)}"
    yield finding.verdict
    yield "–" if together.ours is None else verdict(together.ours)


def variation_row(finding: Finding, together: Finding) -> Iterator[str]:
    """A change, the difference that it makes, and the verdicts, alone and jointly."""
    verdicts = {"holds": "raises", "the opposite holds": "lowers"}
    yield finding.claim.text
    yield finding.claim.formula
    yield finding.part
    yield task_names(finding.tasks) if finding.tasks else "–"
    yield NOT_RUN if finding.ours is None else signed(finding.ours)
    for ours in (finding.ours, together.ours):
        yield NOT_RUN if ours is None else verdicts.get(verdict(ours), verdict(ours))


def agreement_row(agreement: Agreement, label: str) -> Iterator[str]:
    yield label
    yield agreement.part
    yield task_names(agreement.tasks)
    yield from map(interval_text, (agreement.ours, agreement.published))
    yield signed(agreement.difference)
    yield agreement.verdict


def variant_cell(finding: Finding, together: Finding) -> str:
    """The difference above its interval; bold if 0 is outside the joint interval of all cells."""
    ours = finding.ours
    if ours is None:
        return ""
    difference, _, interval = signed(ours).partition(" ")
    if together.ours and (together.ours.low > 0 or together.ours.high < 0):
        difference = f"**{difference}**"
    return "<br>".join(filter(None, (difference, interval)))


def task_names(tasks: Sequence[str]) -> str:
    return ", ".join(tasks) if len(tasks) < 3 else f"{len(tasks)} tasks"


def order_table(rows: Sequence[MethodRuns], part: str) -> str:
    """A table of methods, ordered by our means; empty for fewer than two."""
    tasks, places = order(rows, part)
    labels = {row.method: row.label for row in rows}
    if len(places) < 2:
        return ""
    header = ("Rank", "Row", "Ours", "Published", "Published rank")
    lines = (
        (
            p.rank,
            labels[p.method],
            interval_text(p.ours),
            interval_text(p.published),
            p.published_rank,
        )
        for p in places
    )
    return f"{part}, {task_names(tasks)}:\n\n{table(header, lines)}"


def cell_table(label: str, cells: Sequence[ComparedCell]) -> str:
    """A heading and a table; in each cell our mean, the published one, and the distance."""
    rows = []
    for task, of_task in group_by(cells, attrgetter("task")).items():
        texts = {cell.variant: cell_text(cell) for cell in of_task}
        runs = {len(cell.means) for cell in of_task}
        name = f"{task} ({max(runs)} {'run' if runs == {1} else 'runs'})"
        rows.append([name, *(texts.get(variant, "") for variant in SHORT_VARIANTS)])
    return f"### {label}\n\n{table(('Task', *SHORT_VARIANTS), rows)}"


def score_table(row: MethodRuns) -> str:
    """A heading and a table: means and standard deviations over runs."""
    tasks: dict[str, dict[str, str]] = {}
    for env_id in row.env_ids:
        means = row.runs_in(env_id)
        spread = f" ± {means.std(ddof=1):.2f}" if len(means) > 1 else ""
        cells = tasks.setdefault(env_id.task, {})
        listed = means_apart(means.tolist())
        cells[short_variant(env_id.variant)] = f"{means.mean():.2f}{spread}{listed}"
    lines = [
        [task, *(cells.get(variant, "") for variant in SHORT_VARIANTS)]
        for task, cells in tasks.items()
    ]
    return f"### {row.label}\n\n{table(('Task', *SHORT_VARIANTS), lines)}"


def cell_text(cell: ComparedCell) -> str:
    ours = f"{cell.mean:.2f}" + (f" ± {cell.std:.2f}" if len(cell.means) > 1 else "")
    ours += means_apart(cell.means.tolist())
    distance = distance_text(cell.distance)
    shown = f"**{distance}**" if abs(cell.distance) > LIMITS[-1] else distance
    return f"{ours}<br>{cell.published.mean:.2f} ± {cell.published.std:.2f}<br>{shown}"


def listed_names(names: Sequence[str]) -> str:
    more = len(names) - MAX_LISTED
    return ", ".join(names[:MAX_LISTED]) + (f" and {more} more" if more > 0 else "")
