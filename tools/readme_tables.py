"""Write the generated tables of pages, between their `<!-- name -->` and `<!-- end -->` markers.

python tools/readme_tables.py [--check]

With --check, nothing is written; the exit status is 1 if a page is out of date.
"""

import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from statistics import fmean
from textwrap import TextWrapper

from magical.evaluation import published_table, published_tasks
from magical.observe import PRESETS, PixelSpec
from magical.report.leaderboard import make_leaderboard
from magical.report.leaderboard.ranking import ALL_TASKS
from magical.tasks import TASKS, get_task
from magical.tasks.programs.suite import SUITE, task_name

ROOT = Path(__file__).resolve().parents[1]
WRAP = TextWrapper(84, initial_indent="    ", subsequent_indent="      ")
PAPER = "BC (ST)"  # the published row shown for comparison
# Shown regardless of rank: behavioural cloning, and the best method from human demonstrations.
SHOWN = ("BC (ST)", "BC (MT)", "program-bc (ST), human")


def table(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A Markdown table."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(f"| {' | '.join(map(str, line))} |" for line in lines)


def presets() -> str:
    """One row per observation preset."""
    return table(
        ("Preset", "Observation"), ((f"`{name}`", describe(p)) for name, p in PRESETS.items())
    )


def describe(preset: PixelSpec) -> str:
    """A preset in words."""
    if preset.separate:
        entries = (f"`{view}` {preset.shape(frames)}" for view, frames in preset.parts)
        return f"dict of {', '.join(entries)}"
    views = " and ".join(f"{frames} `{view}`" for view, frames in preset.parts)
    return f"{views} frames, {preset.shape(sum(frames for _, frames in preset.parts))}"


def results() -> str:
    """Mean scores over all tasks: the expert, the best entries, `SHOWN`, and the paper's BC.

    The best entries are those of rank 1, with and without a prior made for the benchmark.
    """
    boards = make_leaderboard([ROOT / "studies"]).boards
    standings = [row for board in boards if ALL_TASKS in board.name for row in board.standings]
    rows: list[Sequence[str]] = [
        (
            "scripted expert" if row.is_reference else row.method + row.statements.mark,
            f"{row.demo.value:.2f}",
            f"{row.test_all.value:.2f}",
            "–" if row.is_reference else row.unit.removeprefix("rollouts of ").partition(" ")[0],
            ", ".join(row.used),
            row.statements.demonstrations or "none",
        )
        for row in standings
        if row.is_reference or row.place == "1" or row.method in SHOWN
    ]
    paper = published_table()
    means = (
        f"{fmean(paper[task, PAPER, variant].mean for task in published_tasks()):.2f}"
        for variant in ("Demo", "All")
    )
    rows.append((f"{PAPER}, published", *means, "5", "demonstrations", "10 of each task (human)"))
    return table(("Method", "Demo", "TestAll", "Runs", "Used", "Demonstrations"), rows)


def programs() -> str:
    """The programs of seven of the paper's tasks and three suite tasks, with instructions."""
    tasks = [task for task in TASKS.values() if task.section and task.name != "ClusterShape"]
    tasks += [get_task(task_name(number)) for number in SUITE[:3]]
    lines = ["```text"]
    for task in tasks:
        words = f"{task.program!r}", task.instruction(task.demo)
        lines += [task.name, *map(WRAP.fill, words)]
    return "\n".join([*lines, "```"])


PAGES: Mapping[Path, Mapping[str, Callable[[], str]]] = {
    ROOT / "README.md": {"results": results},
    ROOT / "docs/observations.md": {"presets": presets},
    ROOT / "docs/programs.md": {"programs": programs},
}


def renew(text: str, page: Path, tables: Mapping[str, Callable[[], str]]) -> str:
    """A page's text with every table regenerated."""
    for name, make in tables.items():
        before, found, rest = text.partition(f"<!-- {name} -->\n")
        _, closed, after = rest.partition("<!-- end -->")
        if not found or not closed:
            raise SystemExit(f"{page.name}: expected <!-- {name} --> and <!-- end -->")
        text = before + found + make() + "\n" + closed + after
    return text


def renew_page(
    arguments: Sequence[str], page: Path, tables: Mapping[str, Callable[[], str]]
) -> int:
    """Write a page's tables, or compare them with --check; returns 1 if they are out of date."""
    old = page.read_text(encoding="utf-8")
    new = renew(old, page, tables)
    if "--check" in arguments:
        return int(new != old)
    page.write_text(new, encoding="utf-8")
    return 0


def main(arguments: Sequence[str]) -> int:
    """Write or compare the tables of all pages; returns 1 if any are out of date."""
    return max(renew_page(arguments, page, tables) for page, tables in PAGES.items())


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
