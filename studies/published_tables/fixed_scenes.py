"""How far the protocol's fixed scenes lie from the mean over many.

    python studies/published_tables/fixed_scenes.py expert --out runs/fixed-scenes
    python studies/published_tables/fixed_scenes.py runs/MoveToCorner runs/MakeLine --label BC \
        --out runs/fixed-scenes
    python studies/published_tables/fixed_scenes.py --out runs/fixed-scenes

Every policy is evaluated on the fixed scenes (seed set 0) and on those of other sets. Policies of
one label share a table: its cells are the mean score on the fixed scenes and, in brackets, that
mean minus the others'; a star marks differences whose 95% interval (normal, over rollouts) excludes
0. Without policies the tables of what the folder holds are printed. What was evaluated before is
kept in the folder and not evaluated again.
"""

import argparse
import math
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from magical.evaluation import (
    Policy,
    environments,
    evaluate,
    load_policy,
    read_scores,
    write_scores,
)
from magical.tasks import TASKS
from magical.tasks.axes import short_variant

Z = 1.96  # half the width of a 95% interval, in standard errors


class Difference(NamedTuple):
    """The fixed scenes of one environment beside others."""

    fixed: float  # mean score
    difference: float  # minus the others' mean
    error: float  # standard error of the difference


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("policies", nargs="*", metavar="POLICY", help="as in magical evaluate")
    parser.add_argument("--out", type=Path, required=True, metavar="FOLDER")
    parser.add_argument("--label", help="the table's name (default: the policy's)")
    parser.add_argument("--sets", type=int, default=5, metavar="N", help="others; default: 5")
    parser.add_argument("--rollouts", type=int, default=100, help="of a set; default: 100")
    parser.add_argument("--workers", type=int, default=0, help="processes; default: 0")
    args = parser.parse_args()
    policies = [(args.label or Path(name).name, load_policy(name)) for name in args.policies]
    for seed in range(args.sets + 1):
        for label, policy in policies:
            measure(policy, args.out / label, seed, args.rollouts, args.workers)
    for folder in sorted(path for path in args.out.iterdir() if path.is_dir()):
        print_table(folder)


def measure(policy: Policy, folder: Path, seed: int, rollouts: int, workers: int) -> None:
    """Evaluate a policy in all environments of its tasks that are missing in the folder."""
    for env_id in environments(getattr(policy, "tasks", None)):
        file = folder / f"{env_id.task}-{env_id.variant}" / f"{seed}.csv"
        if not file.exists():
            scores = evaluate(policy, [env_id], rollouts=rollouts, seed=seed, workers=workers)
            write_scores(scores, file)
            print(file, f"{np.mean([row.score for row in scores]):.3f}", flush=True)


def print_table(folder: Path) -> None:
    """Print the table of one label, in Markdown, and a summary."""
    found = {}
    for path in folder.iterdir():
        sets = {int(file.stem): scores_of(file) for file in path.glob("*.csv")}
        if 0 in sets and len(sets) > 1:
            found[path.name] = compare(sets.pop(0), np.concatenate(list(sets.values())))
    rows: dict[str, dict[str, str]] = defaultdict(dict)
    for env_id in environments(TASKS):
        name = f"{env_id.task}-{env_id.variant}"
        if name in found:
            rows[env_id.task][short_variant(env_id.variant)] = cell(found[name])
    if found:
        print_markdown(folder.name, rows)
        print_summary(list(found.values()))


def scores_of(file: Path) -> NDArray[np.float64]:
    """The scores of an evaluation's rollouts."""
    return np.array([row.score for row in read_scores(file)])


def compare(fixed: NDArray[np.float64], others: NDArray[np.float64]) -> Difference:
    """The mean of one set of scores beside the mean of others."""
    error = math.sqrt(sum(scores.var(ddof=1) / len(scores) for scores in (fixed, others)))
    return Difference(float(fixed.mean()), float(fixed.mean() - others.mean()), error)


def cell(found: Difference) -> str:
    star = "*" if abs(found.difference) > Z * found.error else ""
    return f"{found.fixed:.2f} ({found.difference:+.2f}{star})"


def print_markdown(title: str, rows: dict[str, dict[str, str]]) -> None:
    """Print cells by task and variant."""
    tasks = sorted(TASKS.values(), key=lambda task: -len(task.variants))
    variants = dict.fromkeys(short_variant(name) for task in tasks for name in task.variants)
    print("", "|".join(["", title, *variants, ""]), "|---" * (len(variants) + 1) + "|", sep="\n")
    for task, cells in rows.items():
        print("|".join(["", task, *(cells.get(variant, "") for variant in variants), ""]))


def print_summary(found: Sequence[Difference]) -> None:
    """Print the mean difference over environments, and how the differences scatter."""
    differences = np.array([one.difference for one in found])
    errors = np.array([one.error for one in found])
    expected = math.sqrt(float((errors**2).mean()))
    beyond = int((np.abs(differences) > Z * errors).sum())
    print(
        f"\n{len(found)} environments: mean difference {differences.mean():+.4f} (standard error "
        f"{math.sqrt((errors**2).sum()) / len(found):.4f}); root mean square "
        f"{math.sqrt((differences**2).mean()):.3f}, by chance {expected:.3f}; {beyond} with an "
        f"interval that excludes 0"
    )


if __name__ == "__main__":
    main()
