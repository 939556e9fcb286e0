"""The studies' plans: runs, demonstrations, and how they are evaluated."""

from pathlib import Path

import pytest

from magical.evaluation import published_methods
from magical.evaluation.protocol import Evaluation, environments
from magical_baselines.experiments.plan import Plan, planned_runs
from tests.studies import study_plans


def read_study_plan(root: Path, name: str) -> Plan:
    (path,) = root.glob(f"studies/*/plans/{name}.toml")
    return study_plans.read_study_plan(path)


RESULTS = {  # the plans of the benchmark's own results: number of runs, demonstrations
    "bc-human": (8 * 5, "dataset"),
    "bc-human-paper": (2 * 2, "dataset"),
    "bc-multi-human": (3, "dataset"),
    "bc-ablations-human": (3 * 8 * 5, "dataset"),
    "adversarial-human": (3 * 3 * 3, "dataset"),
    "gail-published-code": (8 * 3, "dataset"),
    "adversarial-published-code": (4 * 8 * 3 + 3, "dataset"),
    "bc-scripted": (8 * 5, "expert"),
    "bc-perturbed": (8 * 5, "expert, perturb 0.2, min_score 1"),
    "bc-mixed": (8 * 5, "dataset and expert"),
    "bc-perturbed-100": (8 * 3, "expert, perturb 0.2, min_score 1"),
    "training-time": (2 * 3 * 3, "dataset"),
    "training-time-multi": (3, "dataset"),
    "training-time-adversarial": (3 * 3, "dataset"),
    "settings": (4 * 2 * 3, "dataset"),
    "settings-published-code": (2 * 8 * 5, "dataset"),
    "settings-adversarial": (2 * 3, "dataset"),
    "settings-gail": (4 * 3, "dataset"),
}
PRESETS = {  # the others: quick
    "bc-human-paper": "paper",
    "gail-published-code": "published-code",
    "adversarial-published-code": "published-code",
}


@pytest.mark.parametrize("name", RESULTS)
def test_the_results_are_evaluated_as_the_published_scores_were(root: Path, name: str) -> None:
    runs = planned_runs(read_study_plan(root, name))
    assert (len(runs), {str(run.source) for run in runs}) == (RESULTS[name][0], {RESULTS[name][1]})
    for run in runs:
        env_ids = tuple(environments(run.tasks))
        assert run.evaluation == Evaluation(env_ids=env_ids, horizon="published")
        assert run.preset == PRESETS.get(name, "quick")
        assert run.config.threads == (2 if name == "bc-human-paper" else 1)
        assert run.method.split("), ")[0].removesuffix(")") + ")" in published_methods()


def test_no_two_plans_of_the_results_share_a_row(root: Path) -> None:
    plans = [read_study_plan(root, name) for name in RESULTS]
    names = [method.name for plan in plans for method in plan.methods]
    assert len(names) == len(set(names)) == 34


@pytest.mark.parametrize(
    ("name", "source", "num_demos"),
    [("object-bc", "expert, perturb 0.2, min_score 1", 100), ("object-bc-human", "dataset", 10)],
)
def test_the_objects_is_evaluated_in_the_same_way(
    root: Path, name: str, source: str, num_demos: int
) -> None:
    runs = planned_runs(read_study_plan(root, name))
    assert len(runs) == 3 + 3 * 8
    for run in runs:
        env_ids = tuple(environments(run.tasks))
        assert run.evaluation == Evaluation(env_ids=env_ids, horizon="published")
        assert (str(run.source), run.config.to_dict()["num_demos"]) == (source, num_demos)


def test_the_learners_of_sequences_are_trained_and_evaluated_as_bc(root: Path) -> None:
    baseline = planned_runs(read_study_plan(root, "bc-human"))
    runs = planned_runs(read_study_plan(root, "sequence-learners"))
    assert len(runs) == 5 * len(baseline)
    known = {(run.tasks, run.config.seed): run for run in baseline}
    for run in runs:
        of_bc = known[run.tasks, run.config.seed]
        assert (run.source, run.evaluation, run.preset) == (of_bc.source, of_bc.evaluation, "quick")
        assert (run.config.threads, run.config.to_dict()["num_demos"]) == (1, 10)
    assert len({run.config.replace(seed=0, tasks="FindDupe") for run in runs}) == 5


def test_the_baseline_learns_from_the_demonstrations_of_the_objects(root: Path) -> None:
    baseline, *_ = planned_runs(read_study_plan(root, "bc-perturbed-100"))
    objects, *_ = planned_runs(read_study_plan(root, "object-bc"))
    assert baseline.source == objects.source
    num_demos = (run.config.to_dict()["num_demos"] for run in (baseline, objects))
    assert len(set(num_demos)) == 1
