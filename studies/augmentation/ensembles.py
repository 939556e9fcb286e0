"""What an ensemble gives: the runs of one task and method as one policy, beside each by itself.

    magical run studies/augmentation/plans/bc-transformations.toml
    python studies/augmentation/ensembles.py runs/bc-transformations --method BC --out ensembles

The members' scores are those of the results folder; the ensemble's are kept in --out.
"""

import argparse
from collections import defaultdict
from pathlib import Path

from magical.evaluation import RolloutScore, evaluate, read_scores, write_scores
from magical.evaluation.statistics import run_means
from magical.learning import EnsemblePolicy
from magical.runs.plan import RUNS, read_listing
from magical.tasks.axes import short_variant


def ensemble_scores(
    runs: list[Path], members: list[RolloutScore], file: Path
) -> list[RolloutScore]:
    """The ensemble's scores in the environments of one member's, from the file if it is there."""
    if not file.exists():
        env_ids = list(dict.fromkeys(row.env_id for row in members))
        rollouts = len(members) // len(env_ids)
        found = evaluate(EnsemblePolicy.load(runs, "cpu"), env_ids, rollouts=rollouts, workers=0)
        file.parent.mkdir(parents=True, exist_ok=True)
        write_scores(found, file)
    return read_scores(file)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("results", type=Path, metavar="DIR", help="the results folder of a plan that is done")
    add("--method", required=True, help="of the plan")
    add("--out", type=Path, required=True, help="folder for the ensembles' scores")
    arguments = parser.parse_args()
    groups: dict[str, list[Path]] = defaultdict(list)
    for run in read_listing(arguments.results).runs:
        if run.method == arguments.method:
            groups["+".join(run.tasks)].append(arguments.results / RUNS / run.folder)
    if not groups:
        parser.error(f"{arguments.results}: no runs of the method {arguments.method!r}")
    for task, runs in groups.items():
        single = [read_scores(run / "scores.csv") for run in runs]
        together = ensemble_scores(runs, single[0], arguments.out / f"{task}.csv")
        for env_id in dict.fromkeys(row.env_id for row in together):
            members = run_means(single, [env_id])
            mean = run_means([together], [env_id])
            name = f"{env_id.task} {short_variant(env_id.variant)}"
            print(f"{name:24} members {members.mean():.2f}  ensemble {mean.mean():.2f}", flush=True)


if __name__ == "__main__":
    main()
