"""Write the generated tables of pages, between their `<!-- name -->` and `<!-- end -->` markers.

python tools/readme_tables.py [--check]

With --check, nothing is written; the exit status is 1 if a page is out of date.
"""

import sys
import tomllib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from operator import attrgetter
from pathlib import Path
from statistics import fmean
from typing import NamedTuple

from magical.evaluation import published_table, published_tasks
from magical.grouping import group_by
from magical.observe import PRESETS, PixelSpec
from magical.report.found import Found, Result, search_results
from magical.report.leaderboard import ALL_TASKS, Standing, check_entries, make_boards
from magical.runs import DEMONSTRATIONS, INTERACTION, track_of

ROOT = Path(__file__).resolve().parents[1]
LEAST_RUNS = 3  # of each task in a row of results
EXACT = "‡"  # marks scores in exact scenes, with the published horizon
HUMAN = "human"  # in a plan: a dataset of the published demonstrations, which is downloaded
LEADERBOARD = "leaderboard"  # the folder of a run's evaluation by the protocol
# Shown regardless of rank: behavioural cloning, also from the demonstrations of object-bc, and the
# best method from human demonstrations.
SHOWN = ("BC (ST)", "BC (MT)", "BC (ST), 100 perturbed experts", "program-bc (ST), human")
# The published rows shown for comparison, and what they learned from.
PAPER = {"BC (ST)": (DEMONSTRATIONS,), "GAIL (ST)": (DEMONSTRATIONS, INTERACTION)}


def table(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
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
        entries = (f"`{view}` {space.shape}" for view, space in preset.space.items())
        return f"dict of {', '.join(entries)}"
    views = " and ".join(f"{frames} `{view}`" for view, frames in preset.parts)
    return f"{views} frames, {preset.space.shape}"


class Row(NamedTuple):
    """A method's row of results, the runs that it is made from, and a mark of how."""

    standing: Standing
    runs: Sequence[Result]
    mark: str = ""

    @property
    def method(self) -> str:
        return self.standing.method

    @property
    def name(self) -> str:
        marks = self.standing.statements.mark + self.mark
        return "scripted expert" if self.is_reference else self.method + marks

    @property
    def is_reference(self) -> bool:
        return self.standing.is_reference

    @property
    def num_runs(self) -> int:
        """The number of runs of each task: that of the task with the fewest."""
        counts = Counter(task for run in self.runs for task in run.entry.tasks)
        return min(counts[task] for task in published_tasks())

    @property
    def command(self) -> str:
        """What makes its runs: a plan, or the evaluation of a policy that is not trained."""
        _, study, _, name, *_ = self.runs[0].folder.relative_to(ROOT).parts
        plan = ROOT / "studies" / study / "plans" / f"{name}.toml"
        if not plan.exists():
            return f"magical evaluate {name} --leaderboard --out runs/{name}"
        human = tomllib.loads(plan.read_text()).get("demos") == HUMAN
        demos = f" --demos {HUMAN}" if human else ""
        return f"magical run {plan.relative_to(ROOT).as_posix()}{demos}"


def result_rows(found: Found) -> list[Row]:
    """The expert, the best entries with and without a prior made for the benchmark, and `SHOWN`.

    Those of `SHOWN` that the protocol was not applied to in enough runs have the scores in exact
    scenes, with the published horizon, and a mark.
    """
    ranked, _ = check_entries(found)
    rows: list[Row] = []
    for board in _rows(ranked):
        several = [row for row in board if row.num_runs >= LEAST_RUNS and not row.is_reference]
        rows += [row for row in board if row.is_reference]
        rows += [row for row in several if row is several[0] or row.method in SHOWN]
    missing = set(SHOWN) - {row.method for row in rows}
    exact = [run for run in found.results if run.folder.name != LEADERBOARD]
    others = [run for run in exact if run.entry.method in missing]
    rows += [row._replace(mark=EXACT) for board in _rows(others) for row in board]
    counts = {row.method: row.num_runs for row in rows}
    for name in SHOWN:
        if (count := counts.get(name, 0)) < LEAST_RUNS:
            raise SystemExit(f"{name}: expected {LEAST_RUNS} runs of each task, found {count}")
    return sorted(rows, key=lambda row: (not row.is_reference, -row.standing.test_all.value))


def _rows(results: Sequence[Result]) -> Iterator[list[Row]]:
    """The rows of each board of all tasks."""
    runs = [run for run in results if not set(published_tasks()).isdisjoint(run.entry.tasks)]
    groups = group_by(runs, attrgetter("entry.method"))
    for board in make_boards(runs):
        if ALL_TASKS in board.name:
            yield [Row(standing, groups[standing.method]) for standing in board.standings]


def results() -> str:
    """Mean scores over all tasks, beside the paper's BC and GAIL, and the command of each row."""
    rows = result_rows(search_results([ROOT / "studies"]))
    lines: list[Sequence[object]] = [
        (
            row.name,
            row.standing.track or "–",
            f"{row.standing.demo.value:.2f}",
            f"{row.standing.test_all.value:.2f}",
            "–" if row.is_reference else row.num_runs,
            ", ".join(row.standing.used),
            row.standing.statements.demonstrations or "none",
        )
        for row in rows
    ]
    paper = published_table()
    for method, used in PAPER.items():
        means = (
            f"{fmean(paper[task, method, variant].mean for task in published_tasks()):.2f}"
            for variant in ("Demo", "All")
        )
        made = ", ".join(used), "10 of each task (human)"
        lines.append((f"{method}, published", track_of(used) or "–", *means, 5, *made))
    header = ("Method", "Track", "Demo", "TestAll", "Runs", "Used", "Demonstrations")
    groups = group_by(rows, attrgetter("command"))
    commands = (f"{text}  # {'; '.join(r.name for r in made)}" for text, made in groups.items())
    return "\n".join([table(header, lines), "", "```bash", *commands, "```"])


PAGES: Mapping[Path, Mapping[str, Callable[[], str]]] = {
    ROOT / "README.md": {"results": results},
    ROOT / "docs/environments.md": {"presets": presets},
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
