"""Pre-training on training tasks, then fine-tuning on a demonstration of a held-out one."""

from dataclasses import replace
from pathlib import Path
from typing import Any

from magical.demos.generate import generate
from magical.evaluation import read_entry
from magical.experiments.one_run import finish
from magical.experiments.plan import Method, Plan, planned_runs
from magical.learning import train
from magical.learning.algorithms.bc import BCConfig
from magical.report.found.search import Result
from magical.report.leaderboard.ranking import held_out_board, pretrained_board
from magical.tasks.programs.suite import HELD_OUT, TRAINING, task_name

TINY: dict[str, Any] = {"num_demos": 1, "batches": 2, "batch_size": 4, "device": "cpu"}


def test_a_fine_tuned_run_is_evaluated_for_the_board_of_its_number_of_demonstrations(
    tmp_path: Path,
) -> None:
    before = [task_name(number) for number in TRAINING[:2]]
    held_out = task_name(HELD_OUT[0])
    for task in (*before, held_out):
        generate(f"magical/{task}-Demo-v0", 1, tmp_path / "demos", workers=0)
    demos, pretrained = str(tmp_path / "demos"), str(tmp_path / "pretrained")
    train(BCConfig.preset("quick", tasks=tuple(before), demos=demos, **TINY), pretrained)

    settings = {"init_from": pretrained, **TINY}
    method = Method(name="tuned", algorithm="bc", preset="quick", settings=settings)
    plan = Plan(
        methods=(method,), tasks=(held_out,), demos=demos, rollouts=2, variants=("Demo", "TestAll")
    )
    (run,) = planned_runs(plan)
    outcome = finish(run, tmp_path / "run", Path(demos))
    assert (outcome.state, outcome.error) == ("done", "")
    entry = read_entry(tmp_path / "run")
    assert len(entry.scores) == 4
    assert entry.details["pretrained_on"] == before
    assert held_out_board([Result(tmp_path / "run", entry)]) == pretrained_board(1)
    odd = replace(entry, details={**entry.details, "num_demos": [10]})
    assert held_out_board([Result(tmp_path / "run", odd)]) == ""
