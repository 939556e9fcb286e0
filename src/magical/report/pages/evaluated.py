"""A page about evaluated runs: tables, learning curves, rollouts."""

from collections.abc import Sequence
from pathlib import Path

from magical import __version__
from magical.evaluation import Entry
from magical.report.figures.curves import curves_by_task
from magical.report.figures.plots import interval_plot
from magical.report.figures.reels import LoadPolicy, Reel, record_reels
from magical.report.found.search import Found
from magical.report.pages.page import Figure, render_template, write_text
from magical.report.scores.methods import ComparedMethod, compared_methods
from magical.report.scores.summaries import aggregate_table, gap_table
from magical.report.scores.tables import DARKEST, LIGHTEST, TextTable, report_tables
from magical.tasks.axes import CHANGED, short_variant


def write_page(
    path: Path,
    title: str,
    found: Found,
    published: Sequence[str] = (),
    *,
    load_policy: LoadPolicy | None = None,
    clips: int = 0,
    conclusions: Sequence[str] = (),
) -> Sequence[str]:
    """Write a page with all results of evaluated runs and their training.

    Everything is in this one file; empty sections are left out.

    Args:
        path: the page to write.
        title: the page's title.
        found: the result of `find_results`.
        published: rows of the published tables to show.
        load_policy: loads a run's policy; needed if `clips` is not 0.
        clips: the number of runs whose best, median and worst rollouts are recorded.
        conclusions: sentences at the beginning of the page.

    Returns:
        Why there are no rollouts, if some were requested and none could be recorded.

    Raises:
        OSError: the page cannot be written.
    """
    reels, notes = (
        record_reels(found.results, load_policy, clips) if load_policy and clips else ([], [])
    )
    write_text(path, _html(title, found, published, reels, notes, conclusions))
    return () if reels else notes


def _html(
    title: str,
    found: Found,
    published: Sequence[str],
    reels: Sequence[Reel],
    notes: Sequence[str],
    conclusions: Sequence[str],
) -> str:
    methods = compared_methods(found.entries)
    curves, damaged = curves_by_task(found.results)
    skipped = [(str(item.folder), item.reason) for item in found.skipped]
    skipped += [(str(folder), reason) for folder, reason in damaged.items()]
    return render_template(
        "page.html.j2",
        lightest=f"rgb{LIGHTEST}",
        darkest=f"rgb{DARKEST}",
        title=title,
        subtitle=_subtitle(found, len(skipped)),
        conclusions=conclusions,
        changed=_changed(found.entries),
        tables=report_tables(found.entries, published),
        rollouts=_rollouts(found.entries),
        aggregate=aggregate_table(methods, found.entries) if methods else None,
        aggregate_figures=_figures(methods) if methods else (),
        gaps=gap_table(methods) if methods else None,
        curves=curves,
        extremes=reels,
        clip_notes=notes,
        skipped=_skipped(skipped),
        version=__version__,
    )


def _changed(entries: Sequence[Entry]) -> dict[str, str]:
    """What differs from the Demo scene in each variant that was evaluated."""
    evaluated = {row.env_id.variant for entry in entries for row in entry.scores}
    return {short_variant(name): text for name, text in CHANGED.items() if name in evaluated}


def _rollouts(entries: Sequence[Entry]) -> str:
    """The number of rollouts per variant, or the range if entries differ."""
    counts = {max(row.rollout for row in entry.scores) + 1 for entry in entries}
    return " to ".join(map(str, sorted({min(counts), max(counts)})))


def _subtitle(found: Found, skipped: int) -> str:
    methods = len({entry.method for entry in found.entries})
    runs = len(found.results)
    parts = [
        f"{runs} evaluated run{'s' if runs != 1 else ''} of {methods} "
        f"method{'s' if methods != 1 else ''}"
    ]
    if skipped:
        parts.append(f"{skipped} skipped")
    unscored = len(found.not_evaluated if found.planned is None else found.planned)
    if unscored:
        parts.append(f"{unscored} without scores")
    return "; ".join(parts)


def _figures(methods: Sequence[ComparedMethod]) -> list[Figure]:
    iqm = {method.name: method.interquartile_mean() for method in methods}
    return [
        Figure(
            interval_plot(iqm, "interquartile mean", "iqm"),
            "Interquartile mean: the mean of the middle half of all runs' scores, with 95% "
            "intervals over runs.",
        ),
    ]


def _skipped(rows: Sequence[tuple[str, str]]) -> TextTable | None:
    note = "Folders whose files cannot be used; they contribute nothing to the tables."
    return TextTable("Skipped", ("folder", "reason"), rows, note) if rows else None
