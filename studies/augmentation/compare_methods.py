"""The methods of a plan beside the first of them, by variant: a table in Markdown.

    magical run studies/augmentation/plans/bc-transformations.toml
    python studies/augmentation/compare_methods.py runs/bc-transformations --tasks FindDupe

Means over the tasks that have the variant; "tests" is the mean over all test variants. Bold: the
95% interval, over runs, of the difference from the first method excludes 0. With --by-task a row
for each task and method. Runs that are not done are left out.
"""

import argparse
from collections.abc import Mapping, Sequence
from operator import attrgetter
from pathlib import Path

import numpy as np

from magical.envs import EnvId
from magical.evaluation import RolloutScore
from magical.evaluation.statistics import Floats, difference, run_means
from magical.grouping import group_by
from magical.report.found import search_results
from magical.runs.plan import RUNS, read_listing
from magical.tasks.axes import SHORT_VARIANTS, short_variant

Runs = Sequence[Sequence[RolloutScore]]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("results", type=Path, metavar="DIR", help="results of a plan")
    parser.add_argument("--tasks", nargs="+", metavar="TASK", help="default: all")
    parser.add_argument("--by-task", action="store_true")
    parser.add_argument("--published-rule", action="store_true", help="the published code's scores")
    arguments = parser.parse_args()
    methods = read_methods(arguments.results, arguments.tasks)
    if not methods:
        parser.error(f"{arguments.results}: expected runs that are done, found none")
    rule = "published_code_score" if arguments.published_rule else "score"
    first = next(iter(methods.values()))
    env_ids = list(dict.fromkeys(row.env_id for run in first for row in run))
    tasks = list(dict.fromkeys(env_id.task for env_id in env_ids))
    names = [name for name in SHORT_VARIANTS if name in {short_variant(i.variant) for i in env_ids}]
    print("| Method | " + " | ".join([*names, "tests"]) + " |")
    print("| --- " * (len(names) + 2) + "|")
    for group in [[task] for task in tasks] if arguments.by_task else [tasks]:
        chosen = [env_id for env_id in env_ids if env_id.task in group]
        for method, runs in methods.items():
            title = f"{group[0]}, {method}" if arguments.by_task else method
            cells = [cell(runs, first, part, rule) for part in columns(chosen, names)]
            print(f"| {title} | " + " | ".join(cells) + " |")


def read_methods(results: Path, tasks: Sequence[str] | None) -> Mapping[str, Runs]:
    """The scores of each method's runs, in the plan's order."""
    entries = [r.entry for r in search_results([results]).results if r.folder.parent.name == RUNS]
    rows = {
        method: [
            [row for row in entry.scores if tasks is None or row.env_id.task in tasks]
            for entry in runs
        ]
        for method, runs in group_by(entries, attrgetter("method")).items()
    }
    methods = dict.fromkeys(run.method for run in read_listing(results).runs)
    return {m: kept for m in methods if (kept := list(filter(None, rows.get(m, ()))))}


def columns(env_ids: Sequence[EnvId], names: Sequence[str]) -> list[list[EnvId]]:
    """The environments of each variant, then of all test variants."""
    parts = [[i for i in env_ids if short_variant(i.variant) == name] for name in names]
    return [*parts, [i for i in env_ids if i.variant != "Demo"]]


def cell(runs: Runs, first: Runs, env_ids: Sequence[EnvId], rule: str) -> str:
    """The mean over environments; empty if there is none, or not in all of them."""
    if not env_ids:
        return ""
    table, other = (_evaluated(run_means(part, env_ids, rule)) for part in (runs, first))
    if np.isnan(table).all(axis=0).any():
        return ""
    text = f"{np.nanmean(table, axis=0).mean():.2f}"
    found = difference(table, other)
    return f"**{text}**" if found.low > 0 or found.high < 0 else text


def _evaluated(table: Floats) -> Floats:
    """The runs with scores in any of the columns."""
    chosen: Floats = table[~np.isnan(table).all(axis=1)]
    return chosen


if __name__ == "__main__":
    main()
