"""The page of a quickstart."""

import platform
from collections.abc import Mapping, Sequence
from pathlib import Path

from magical import __version__
from magical.evaluation import Entry, Policy, environments
from magical.files import write_atomically
from magical.processes import available_cores
from magical.report.figures.clips import png, record_clips
from magical.report.figures.contact_sheet import contact_sheet
from magical.report.figures.curves import learning_curves
from magical.report.pages.page import Page
from magical.report.scores.tables import Table, task_table

PUBLISHED = ("BC (ST)",)
SHEET = "contact-sheet.png"


def quickstart_tables(entries: Mapping[str, Sequence[Entry]]) -> list[Table]:
    """A table per task, with the published rows to compare with; `entries` are by task."""
    return [task_table(task, of_task, PUBLISHED) for task, of_task in entries.items()]


def quickstart_page(
    out: Path,
    *,
    tables: Sequence[Table],
    policies: Mapping[str, Policy],
    runs: Mapping[str, Path],
    rollouts: int,
    facts: Mapping[str, str],
) -> Page:
    """The page, after writing the contact sheet to `out`.

    Args:
        out: the quickstart's folder.
        tables: of the scores.
        policies: the trained policy of each task; one episode per variant is shown.
        runs: the run folder of each task, for the learning curves.
        rollouts: the number of rollouts on each variant.
        facts: how the results were made.
    """
    sheet = contact_sheet()
    with write_atomically(out / SHEET) as file:
        file.write(png(sheet))
    return Page(
        title="MAGICAL quickstart",
        subtitle="A policy is trained on demonstrations of the Demo variant alone, then has to do "
        "the same where something else has changed: the less a score drops, the better it "
        "generalises.",
        tables=tables,
        rollouts=rollouts,
        curves=learning_curves(runs),
        reels={
            f"BC quick on {task}": record_clips(policy, environments([task]))
            for task, policy in policies.items()
        },
        sheet=sheet,
        facts=facts,
    )


def quickstart_facts(
    *, demos: int, rollouts: int, observation: str, seed: int, seconds: Mapping[str, float]
) -> dict[str, str]:
    """How a quickstart's results were made; `seconds` is the duration of each part."""
    return {
        "demonstrations": f"{demos} of each task's Demo variant, by the scripted expert",
        "training": "behavioural cloning, preset quick, one policy for each task, pixels "
        f"({observation})",
        "evaluation": f"{rollouts} rollouts on each variant, fixed seeds",
        "published rows": "appendix, Table 5: ten human demonstrations, 20,000 batches, five runs",
        "seed": str(seed),
        "versions": f"magical {__version__}, Python {platform.python_version()}",
        "machine": f"{platform.machine()}, {available_cores()} cores",
        **{f"seconds for {name}": f"{spent:.0f}" for name, spent in seconds.items()},
    }
