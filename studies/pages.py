"""Write the generated tables of the studies, in pages and as CSV, and the picture.

python -m studies.pages [--check]

With --check nothing is written; the exit status is 1 if a page, a table or the picture is out of
date.
"""

import csv
import hashlib
import io
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property, partial
from pathlib import Path

from magical.envs import EnvId
from magical.evaluation import published_tasks
from magical.grouping import group_by
from magical.report.found import Found, search_results
from magical.report.leaderboard import (
    ALL_TASKS,
    Board,
    Rejected,
    by_reasons,
    check_entries,
    make_boards,
)
from magical.report.table import Statements, interval_text, over, signed
from magical.tasks.axes import SHORT_VARIANTS
from studies.generated_tasks.baselines import (
    BESIDE,
    difference_table,
    held_out_table,
    held_out_tasks,
    method_table,
    task_table,
)
from studies.plan_results import LEADERBOARD, NOT_RUN, NOTHING, OTHERS, PLANS, PlanResults
from studies.published_tables.agreement import find_agreements
from studies.published_tables.cells import (
    LIMITS,
    ComparedCell,
    Count,
    count,
    make_cells,
)
from studies.published_tables.claims import (
    CLAIMS,
    HUNDRED,
    PARTS,
    VARIATIONS,
    Claim,
    Finding,
    find,
    find_together,
)
from studies.published_tables.generalisation import find_drops
from studies.published_tables.picture import digest_of, write_picture
from studies.published_tables.rows import MethodRuns, make_rows, published_row, reproduced_row
from studies.tables import (
    agreement_row,
    cell_table,
    claim_row,
    listed_names,
    order_table,
    score_table,
    variant_cell,
    variation_row,
)
from tools.readme_tables import renew_page, table

ROOT = Path(__file__).resolve().parents[1]
BY_TASK = tuple(
    f"program-bc-{name}" for name in ("human", "perception", "training", "scripted")
)  # plans shown as a table by task
SHOWN = {  # of each study's page: a generated table; the columns and the rows that are shown
    "published_tables": ("agreement", "Row|On|Difference|Verdict", "8 tasks"),
    "demonstrations": ("variations", "Change|On|Mean difference|Verdict", "8 tasks"),
    "generated_tasks": ("held-out", "Mean over tasks|Demo|Layout|All.*", ""),
    "intent": ("program-bc-human", r"program-bc \(ST\).*|Demo|All", ""),
    "modern_baselines": ("sequence-learners", "Mean over .*|Demo|Colour|All|Gap", ""),
    "objects": (
        "gaps",
        "Row|Track|Demo|TestAll|Gap",
        r"published \||^BC \(.T\) \||100 perturbed|object-bc|^expert",
    ),
}
CSV = {  # the generated tables in each study's folder `tables`
    "published_tables": ("agreement", "runs", "counts", "claims", "orders", "cells", "rejected"),
    "demonstrations": ("variations", "variants"),
    "generated_tasks": ("held-out", "held-out-tasks"),
    "intent": (
        *("program-bc-human", "program-bc-perception", "program-bc-training"),
        *("program-bc-scripted", "program-bc-few", "object-networks-human"),
    ),
    "modern_baselines": (
        *("sequence-learners", "sequence-learners-held-out", "sequence-learners-longer"),
        *("sequence-learners-executed", "executed-differences", "sequence-learners-hundred"),
        *("iq-learn", "iq-learn-gail"),
    ),
    "objects": ("gaps", "baseline", "object-bc-ablations-human", "leaderboard", "others"),
}
EXECUTED = "sequence-learners-executed"
PICTURE = Path("published_tables", "results.png")
BASELINE = ("object-bc (ST)", HUNDRED)  # both learned from the same demonstrations
EXPERT = "expert"  # folder and method of the scripted experts' entry, which is not part of a plan


class Page:
    """The generated contents of the studies' pages, from a repository's folder `studies`."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.plans = [PlanResults.read(root, name) for name in PLANS]
        shown, others = _results(root, (*PLANS, EXPERT)), _results(root, OTHERS)
        found, self.rejected = make_rows(_evaluations(shown, leaderboard=False))
        everything = replace(shown, results=[*shown.results, *others.results])
        self.ranked, rejected = check_entries(_evaluations(everything, leaderboard=True))
        self.rejected += rejected
        known = {row.method: row for row in found}
        planned = [method for plan in self.plans for method in plan.methods]
        self.methods = [method for method in planned if published_row(method)]
        self.rows: list[MethodRuns] = [known[name] for name in self.methods if name in known]
        unpublished = [method for method in (*planned, EXPERT) if method not in self.methods]
        self.others = [known[name] for name in unpublished if name in known]
        self.labels = {row.method: row.label for row in (*self.rows, *self.others)}
        self.rejected += [
            Rejected(str(root / "studies"), name, [f"{name} is a method of none of the plans"])
            for name in known
            if name not in (*self.methods, *unpublished)
        ]
        self.tasks = published_tasks()

    @cached_property
    def cells(self) -> dict[str, list[ComparedCell]]:
        """The cells of each method that has been run."""
        return {row.method: make_cells(row) for row in self.rows}

    @cached_property
    def counts(self) -> dict[str, Count]:
        """The counts of each method that has been run."""
        return {method: count(cells) for method, cells in self.cells.items()}

    @property
    def panels(self) -> Mapping[str, Sequence[ComparedCell]]:
        """The picture's panels: the cells of methods with any, or empty panels for all methods."""
        return {m: c for m, c in self.cells.items() if c} or {m: [] for m in self.methods}

    @property
    def digest(self) -> str:
        """The digest of what the picture shows."""
        shown = [
            (method, [(c.task, c.variant, f"{c.distance:.2f}") for c in cells])
            for method, cells in self.panels.items()
        ]
        return hashlib.sha256(repr((self.tasks, shown)).encode()).hexdigest()[:16]

    def sections(self) -> dict[str, Callable[[], str]]:
        """The generated parts, by name."""
        return {
            "runs": self.runs,
            "counts": self.count_table,
            "claims": self.claim_table,
            "agreement": self.agreement_table,
            "variations": self.variation_table,
            "variants": self.variant_table,
            "orders": self.orders,
            "baseline": self.baseline_table,
            "gaps": self.gap_table,
            "leaderboard": self.leaderboard,
            "others": self.other_tables,
            "held-out": partial(held_out_table, self.root),
            "held-out-tasks": partial(held_out_tasks, self.root),
            **{name: partial(task_table, self.root, name) for name in BY_TASK},
            **{name: partial(method_table, self.root, name) for name in BESIDE},
            "executed-differences": partial(difference_table, self.root, EXECUTED),
            "cells": self.cell_tables,
            "rejected": self.rejections,
        }

    def runs(self) -> str:
        """A row for each plan."""
        header = ("Plan", "Runs", "Hours", "Minutes a run", "Version", "Missing")
        studies = (PlanResults.read(self.root, name) for name in OTHERS)
        return table(header, (plan.row() for plan in (*self.plans, *studies)))

    def count_table(self) -> str:
        """A row for each method: cells within one and two pooled standard deviations."""
        within = (f"Within {limit} (expected)" for limit in LIMITS)
        header = ("Row", "Published", "Cells", *within, "Below", "Above")
        return table(header, map(self._count_row, self.methods))

    def _count_row(self, method: str) -> list[str]:
        published = "the same" if published_row(method) == method else published_row(method)
        names = [self.labels.get(method, method), published]
        if method not in self.counts:
            return [*names, NOT_RUN, *[""] * (len(LIMITS) + 2)]
        return [*names, *_count_cells(self.counts[method])]

    def claim_table(self) -> str:
        """A row for each claim and part of the environments."""
        pairs = self._pairs(CLAIMS)
        header = ("Claim", "On", "Published, all tasks", "Published, our tasks", "Ours", "Verdict")
        return table((*header, _together_header(pairs)), (list(claim_row(*pair)) for pair in pairs))

    def agreement_table(self) -> str:
        """A row for each method that reproduces a published row, and part of the environments."""
        header = ("Row", "On", "Tasks", "Ours", "Published", "Difference", "Verdict")
        found = find_agreements(self.rows)
        rows = [list(agreement_row(row, self.labels[row.method])) for row in found]
        return table(header, rows) if rows else NOTHING

    def variation_table(self) -> str:
        """A row for each variation of BC and part of the environments."""
        pairs = self._pairs(VARIATIONS)
        header = ("Change", "Difference", "On", "Tasks", "Mean difference", "Verdict")
        rows = (list(variation_row(*pair)) for pair in pairs)
        return table((*header, _together_header(pairs)), rows)

    def variant_table(self) -> str:
        """The differences that the variations make, variant by variant."""
        pairs = group_by(self._pairs(VARIATIONS, SHORT_VARIANTS), lambda pair: pair[0].claim.text)
        rows = (
            [text, *(variant_cell(*pair) for pair in of_claim)]
            for text, of_claim in pairs.items()
            if any(finding.ours for finding, _ in of_claim)
        )
        return table(("Change", *SHORT_VARIANTS), rows)

    def _pairs(
        self, claims: Sequence[Claim], parts: Sequence[str] = PARTS
    ) -> list[tuple[Finding, Finding]]:
        """Each finding on its own, and with an interval that holds for all of them jointly."""
        found = find(claims, self.rows, parts), find_together(claims, self.rows, parts)
        return list(zip(*found, strict=True))

    def orders(self) -> str:
        """The methods' order by part: those with all tasks, then all methods on shared tasks."""
        named = [row for row in self.rows if row.published == row.method]
        complete = [r for r in self.rows if reproduced_row(r.method) and self._is_complete(r)]
        groups = [complete] if all(map(self._is_complete, named)) else [complete, named]
        tables = [text for rows in groups for part in PARTS if (text := order_table(rows, part))]
        return "\n\n".join(tables) or NOTHING

    def _is_complete(self, row: MethodRuns) -> bool:
        return {env_id.task for env_id in row.env_ids} >= set(self.tasks)

    def cell_tables(self) -> str:
        """A table for each method that has been run: tasks by variants."""
        parts = [cell_table(self.labels[m], cells) for m, cells in self.cells.items() if cells]
        return "\n\n".join(parts) or NOTHING

    def baseline_table(self) -> str:
        """The object-centred learner and BC from the same demonstrations, task by task."""
        known = {row.method: row for row in (*self.rows, *self.others)}
        rows = [known[name] for name in BASELINE if name in known]
        if len(rows) < len(BASELINE):
            return NOTHING
        lines = []
        for env_id in [i for i in rows[0].env_ids if i.variant == "Demo"]:
            pair = (env_id, EnvId(env_id.task, "TestAll"))
            if all(i in row.env_ids for row in rows for i in pair):
                means = [f"{row.runs_in(i).mean():.2f}" for i in pair for row in rows]
                lines.append([f"{env_id.task} ({len(rows[1].runs_in(env_id))} runs)", *means])
        header = [f"{row.label}, {variant}" for variant in ("Demo", "TestAll") for row in rows]
        return table(("Task", *header), lines)

    def gap_table(self) -> str:
        """Demo, TestAll and the gap of the published methods, and of our methods with all tasks."""
        header = ("Row", "Track", "Demonstrations", "Test evaluations", "Demo", "TestAll", "Gap")
        rows = (
            [
                drop.method + drop.statements.mark,
                drop.track or "–",
                *_stated(drop.statements),
                *(interval_text(drop.demo), interval_text(drop.test_all), signed(drop.gap)),
            ]
            for drop in find_drops([*self.rows, *self.others])
        )
        return table(header, rows)

    def leaderboard(self) -> str:
        """The leaderboard of all tasks, then the one for methods with a benchmark prior."""
        boards = [board for board in make_boards(self.ranked) if ALL_TASKS in board.name]
        return "\n\n".join(map(_standings, boards)) if boards[0].standings else NOTHING

    def other_tables(self) -> str:
        """A table for each row without a published counterpart: tasks by variants."""
        return "\n\n".join(map(score_table, self.others)) or NOTHING

    def rejections(self) -> str:
        """The rejected entries, by reason."""
        rows = (
            (
                reasons.replace(f"{self.root}/", ""),
                listed_names([entry.folder.removeprefix(f"{self.root}/") for entry in entries]),
            )
            for reasons, entries in by_reasons(self.rejected)
        )
        return table(("Reason", "Entries"), rows)


def _results(root: Path, names: Sequence[str]) -> Found:
    """The collected results of plans, or of other results folders, with these names."""
    folders = [path for name in names for path in root.glob(f"studies/*/results/{name}")]
    return search_results(folders) if folders else Found([])


def _evaluations(found: Found, leaderboard: bool) -> Found:
    """Only the leaderboard evaluations, or only the other evaluations of the same policies."""
    kept = [r for r in found.results if (r.folder.name == LEADERBOARD) == leaderboard]
    return replace(found, results=kept, skipped=() if leaderboard else found.skipped)


def _standings(board: Board) -> str:
    head = ("Rank", "Method", "Track", "Demonstrations", "Test evaluations", "Used")
    header = (*head, "Intervals over", "Demo", "TestAll", "Gap", "Rank by gap")
    rows = [
        [
            *(row.place, row.label + row.statements.mark, row.track or "–"),
            *_stated(row.statements),
            *(", ".join(row.used) or "–", row.unit, interval_text(row.demo, row.unit)),
            interval_text(row.test_all, row.unit) + row.runs_apart,
            signed(row.gap) + over(row.gap, row.unit),
            row.gap_place,
        ]
        for row in board.standings
    ]
    return table(header, rows)


def _stated(statements: Statements) -> tuple[str, str]:
    number = statements.test_evaluations
    return statements.demonstrations or "–", "–" if number is None else str(number)


def _together_header(pairs: Sequence[tuple[Finding, Finding]]) -> str:
    """A column heading with the number of tested findings, whose verdicts hold jointly at 95%."""
    return f"All {sum(found.ours is not None for found, _ in pairs)} at once"


def _count_cells(found: Count) -> list[str]:
    pairs = zip(found.within, found.expected, strict=True)
    within = [f"{number} ({expected:.0f})" for number, expected in pairs]
    return [str(found.cells), *within, str(len(found.below)), str(len(found.above))]


def as_csv(text: str) -> str:
    """The Markdown tables of a text as CSV; what stands above a table begins each of its rows."""
    file = io.StringIO()
    write = csv.writer(file, lineterminator="\n").writerow
    above, header = "", ""
    for line in filter(None, text.splitlines()):
        if not line.startswith("|"):
            above, header = line.strip("# :"), ""
        elif not set(line) <= set("| -"):
            cells = [_plain(cell) for cell in line.strip("|").split("|")]
            if not header:
                header = line
                cells = ["", *cells] if above else cells
            elif above:
                cells = [above, *cells]
            write(cells)
    return file.getvalue()


def excerpt(text: str, columns: str, rows: str) -> str:
    """Of the first table whose first heading matches: the matching columns, the rows with a match.

    The whole text if there is no such table.
    """
    for part in filter(None, text.split("\n\n")):
        header, *lines = [line.strip("| ").split(" | ") for line in part.splitlines()]
        numbers = [n for n, heading in enumerate(header) if re.fullmatch(columns, heading)]
        if 0 in numbers:
            kept = [header, *(line for line in lines[1:] if re.search(rows, " | ".join(line)))]
            first, *others = ([line[number] for number in numbers] for line in kept)
            return table(first, others)
    return text


def _plain(cell: str) -> str:
    """A cell without Markdown."""
    cell = re.sub(r"\[([^\]]+)\]\([^)]+\)", r"\1", cell).replace("<br>", "; ")
    return cell.replace("**", "").replace("`", "").strip()


def main(arguments: Sequence[str], root: Path = ROOT) -> int:
    """Write or check the pages, the tables and the picture."""
    page = Page(root)
    picture = root / "studies" / PICTURE
    made = page.sections()
    outdated = False
    texts = {name: made[name]() for names in CSV.values() for name in names}
    for study, (name, columns, rows) in SHOWN.items():
        shown = partial(excerpt, texts[name], columns, rows)
        readme = root / "studies" / study / "README.md"
        outdated |= bool(renew_page(arguments, readme, {name: shown}))
    for study, names in CSV.items():
        for name in names:
            file, text = root / "studies" / study / "tables" / f"{name}.csv", as_csv(texts[name])
            if "--check" not in arguments:
                file.parent.mkdir(exist_ok=True)
                file.write_text(text, encoding="utf-8")
            elif not file.is_file() or file.read_text(encoding="utf-8") != text:
                print(f"{file}: out of date; python -m studies.pages writes it")
                outdated = True
    if "--check" in arguments:
        return int(outdated or digest_of(picture) != page.digest)
    write_picture(picture, page.panels, page.tasks, page.digest)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
