"""The baselines' scores on held-out tasks, as the study's page has them."""

import csv
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np

from magical.envs import EnvId
from magical.evaluation import Entry, RolloutScore
from magical.evaluation.statistics import (
    FEWEST_RUNS,
    Floats,
    Interval,
    difference,
    gap_weights,
    generalisation_gap,
    mean,
    over_rollouts,
    run_means,
)
from magical.grouping import group_by
from magical.report.found import search_results
from magical.report.table import interval_text, marked, over, signed
from magical.tasks.axes import SHORT_VARIANTS, full_variant
from studies.plan_results import LEADERBOARD, NOTHING, PlanResults
from studies.tables import task_names
from tools.readme_tables import table

PLAN = "held-out"
RANDOM = "random"
PLAN_OF = {"iq-learn-gail": "iq-learn"}  # of the parts below that are not named like their plans
BESIDE = {  # plans whose methods are compared with methods of other plans, as {plan: method}
    "sequence-learners": {"bc-human": "BC (ST)"},
    "sequence-learners-held-out": {"held-out": "BC (ST)"},
    "sequence-learners-longer": {
        "sequence-learners": "Diffusion policy (ST)",
        "bc-human": "BC (ST)",
    },
    "sequence-learners-executed": {
        "sequence-learners": "Diffusion policy (ST)",
        "bc-human": "BC (ST)",
    },
    "sequence-learners-hundred": {},
    "iq-learn": {"bc-human": "BC (ST)"},
    "iq-learn-gail": {"adversarial-human": "GAIL (ST)", "bc-human": "BC (ST)"},
    "program-bc-few": {"program-bc-held-out": "program-bc (ST)"},
    "object-networks-human": {
        "bc-human": "BC (ST)",
        "bc-ablations-human": "BC (ST, allo.)",
        "program-bc-human": "program-bc (ST), human",
    },
    "object-bc-ablations-human": {},
}
ENDS = (SHORT_VARIANTS[0], SHORT_VARIANTS[-1])  # Demo and All

Runs = Sequence[Sequence[RolloutScore]]


def held_out_tasks(root: Path) -> str:
    """Held-out tasks by methods: scores on Demo and All."""
    methods = _held_out_methods(root)
    experts = _expert_scores(root / "studies" / "generated_tasks" / "expert.csv")
    header = ("Task", "Expert", *(f"{name} ({_runs(runs)})" for name, runs in methods.items()))
    rows = [
        [task, _pair(experts[task]), *(_pair(_ends(runs, task)) for runs in methods.values())]
        for task in PlanResults.read(root, PLAN).plan["tasks"]
    ]
    return table(header, rows)


def held_out_table(root: Path) -> str:
    """Methods by variants: means over held-out tasks."""
    tasks = PlanResults.read(root, PLAN).plan["tasks"]
    rows = [
        [
            f"{name} ({_runs(runs)})",
            *(_over_tasks(runs, tasks, v) for v in SHORT_VARIANTS),
            _across_tasks(runs, tasks),
        ]
        for name, runs in _held_out_methods(root).items()
    ]
    return table(("Mean over tasks", *SHORT_VARIANTS, "All, interval over tasks"), rows)


def _held_out_methods(root: Path) -> Mapping[str, Runs]:
    results = root / "studies" / "generated_tasks" / "results"
    folders = [*(results / name for name in (RANDOM, PLAN)), *others(root)]
    return {marked(name, of): _scores(of) for name, of in read_methods(folders).items()}


def others(root: Path) -> Iterable[Path]:
    """What other studies collected on held-out tasks."""
    return sorted(root.glob(f"studies/*/results/*-{PLAN}"))


def task_table(root: Path, name: str) -> str:
    """A method's mean scores by task and variant, from what was collected of a plan."""
    plan = PlanResults.read(root, name)
    folders = root.glob(f"studies/*/results/{name}")
    parts = []
    for method, entries in read_methods(folders).items():
        runs = _scores(entries)
        cells = [[_over_tasks(runs, [t], v) for v in SHORT_VARIANTS] for t in plan.plan["tasks"]]
        rows = [[task, *row] for task, row in zip(plan.plan["tasks"], cells, strict=True)]
        over_all = [_over_tasks(runs, plan.plan["tasks"], v) for v in SHORT_VARIANTS]
        header = (f"{marked(method, entries)} ({_runs(runs)})", *SHORT_VARIANTS)
        parts.append(table(header, [*rows, ["mean", *over_all]]))
    return "\n\n".join(parts)


def method_table(root: Path, part: str) -> str:
    """Methods by variants: means over the tasks that all of them have been run on.

    Args:
        root: the repository.
        part: of a page, in `BESIDE`: all methods of its plan are shown, and those beside.
    """
    shown = PlanResults.read(root, PLAN_OF.get(part, part))
    if not shown.collected:
        return NOTHING
    variants = shown.plan.get("variants", SHORT_VARIANTS)
    rows, tasks = _beside(root, shown, BESIDE[part])
    published = [f"{variant}, published rule" for variant in ENDS]
    last = ("Gap", *published, "Minutes of training")
    header = (f"Mean over {task_names(tasks)}", *variants, *last)
    lines = [
        [
            f"{marked(method, entries)} ({_runs(_on(_scores(entries), tasks))})",
            *(_over_tasks(_scores(entries), tasks, variant) for variant in variants),
            _gap(_scores(entries), tasks),
            *(_over_tasks(_scores(entries), tasks, v, "published_code_score") for v in ENDS),
            f"{results.training_minutes(tasks)[method]:.1f}",
        ]
        for method, (entries, results) in rows.items()
    ]
    return table(header, lines)


def difference_table(root: Path, part: str) -> str:
    """The plan's first method less each of the others, by variant; arguments as `method_table`."""
    shown = PlanResults.read(root, PLAN_OF.get(part, part))
    if not shown.collected:
        return NOTHING
    rows, tasks = _beside(root, shown, BESIDE[part])
    (first, (entries, _)), *others = rows.items()
    runs = _scores(entries)
    lines = [
        [
            marked(method, other),
            *(_difference(runs, _scores(other), tasks, variant) for variant in SHORT_VARIANTS),
        ]
        for method, (other, _) in others
    ]
    return table((f"{marked(first, entries)} less", *SHORT_VARIANTS), lines)


def _beside(
    root: Path, shown: PlanResults, beside: Mapping[str, str]
) -> tuple[Mapping[str, tuple[Sequence[Entry], PlanResults]], Sequence[str]]:
    """The runs of a plan's methods and of those beside, and the tasks that all have been run on."""
    rows: dict[str, tuple[Sequence[Entry], PlanResults]] = {}
    for plan, wanted in ((shown.name, None), *beside.items()):
        results = PlanResults.read(root, plan)
        for method, entries in read_methods(root.glob(f"studies/*/results/{plan}")).items():
            if wanted in (None, method):
                rows[method] = entries, results
    scores = [_scores(entries) for entries, _ in rows.values()]
    tasks = [
        task
        for task in shown.plan["tasks"]
        if all(np.isfinite(_means(runs, [task], ENDS[0])).any() for runs in scores)
    ]
    return rows, tasks


def read_methods(folders: Iterable[Path]) -> Mapping[str, Sequence[Entry]]:
    """The entry of each run of each method."""
    found = search_results([path for path in folders if path.exists()])
    # What is evaluated for the leaderboard as well counts once.
    entries = [r.entry for r in found.results if r.folder.name != LEADERBOARD]
    return group_by(entries, lambda entry: entry.method)


def _scores(entries: Sequence[Entry]) -> Runs:
    return [entry.scores for entry in entries]


def _on(runs: Runs, tasks: Sequence[str]) -> Runs:
    return [run for run in runs if any(row.env_id.task in tasks for row in run)]


def _runs(runs: Runs) -> str:
    return f"{len(runs)} {'run' if len(runs) == 1 else 'runs'}"


def _expert_scores(path: Path) -> dict[str, tuple[float, ...]]:
    """Demo's and All's mean by task."""
    with path.open(newline="", encoding="utf-8") as file:
        return {
            f"Generated{int(row['number']):04}": tuple(float(row[name]) for name in ENDS)
            for row in csv.DictReader(file)
        }


def _ends(runs: Runs, task: str) -> tuple[float, ...]:
    means = [_means(runs, [task], variant) for variant in ENDS]
    return tuple(
        float("nan") if np.isnan(each).all() else float(np.nanmean(each)) for each in means
    )


def _means(runs: Runs, tasks: Sequence[str], variant: str, rule: str = "score") -> Floats:
    """(runs, tasks), NaN where a run was not evaluated."""
    return run_means(runs, [EnvId(task, full_variant(variant)) for task in tasks], rule)


def _pair(scores: tuple[float, ...]) -> str:
    return " / ".join("–" if np.isnan(score) else f"{score:.2f}" for score in scores)


def _gap(runs: Runs, tasks: Sequence[str]) -> str:
    """Demo's mean less that of All, with an interval over runs, or over rollouts."""
    env_ids = [EnvId(task, full_variant(variant)) for task in tasks for variant in ENDS]
    scores = run_means(runs, env_ids)
    found = generalisation_gap(scores[~np.isnan(scores).all(axis=1)], env_ids)
    if _lacks_interval(scores, found):
        found = over_rollouts(runs, env_ids, gap_weights(env_ids))
    return signed(found) + over(found, "runs")


def _difference(first: Runs, second: Runs, tasks: Sequence[str], variant: str) -> str:
    """With Welch's interval over runs."""
    ours, theirs = (_means(runs, tasks, variant) for runs in (first, second))
    shared = ~(np.isnan(ours).all(axis=0) | np.isnan(theirs).all(axis=0))
    ours, theirs = ours[:, shared], theirs[:, shared]
    ours, theirs = (part[~np.isnan(part).all(axis=1)] for part in (ours, theirs))
    return signed(difference(ours, theirs))


def _across_tasks(runs: Runs, tasks: Sequence[str]) -> str:
    """The mean on All with Student's t interval over tasks, each a mean over its runs."""
    means = np.nanmean(_means(runs, tasks, ENDS[1]), axis=0)
    return interval_text(mean(means[:, np.newaxis]))


def _over_tasks(runs: Runs, tasks: Sequence[str], variant: str, rule: str = "score") -> str:
    """With an interval over runs, or over rollouts."""
    means = _means(runs, tasks, variant, rule)
    missing = np.isnan(means)
    kept = means[~missing.all(axis=1)][:, ~missing.all(axis=0)]
    if not kept.size:
        return "–"
    found = mean(kept)
    if _lacks_interval(kept, found):
        places = np.flatnonzero(~missing.all(axis=0)).tolist()
        env_ids = [EnvId(tasks[place], full_variant(variant)) for place in places]
        found = over_rollouts(runs, env_ids, np.full(len(env_ids), 1 / len(env_ids)), rule)
    return interval_text(found, "runs")


def _lacks_interval(scores: Floats, found: Interval) -> bool:
    """Whether several runs are too few for an interval over them, or do not differ.

    The tables give a single run's means without an interval.
    """
    runs = (~np.isnan(scores)).sum(axis=0)  # (environments,)
    return bool(runs.max() > 1 and (np.isnan(found.low) or runs.min() < FEWEST_RUNS))
