"""Print which programs of the language of goals explain demonstrations, with their probabilities.

DEMOS is a dataset with poses. A program is weighed by its prior probability and by how likely its
goal makes the moves that were demonstrated. Where a scene leaves open what was meant, many programs
share the weight; where no program explains the demonstrations, this is said.
"""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from magical.commands._common import (
    add_count,
    add_json,
    add_seed,
    add_tasks,
    print_json,
    print_table,
)

if TYPE_CHECKING:
    from magical.demos import Trajectory

HELP = "print which programs explain demonstrations"


def configure(parser: argparse.ArgumentParser) -> None:
    """Describe the command's arguments."""
    parser.add_argument("demos", type=Path, metavar="DEMOS", help="a dataset's folder")
    add_tasks(parser)
    add_count(parser, "--num-demos", "demonstrations of each task", default=10)
    parser.add_argument(
        "--prior",
        choices=("uniform", "suite"),
        default="uniform",
        help="of expressions: uniform, or by how often they occur in the programs of the generated "
        "training tasks (default: uniform)",
    )
    add_count(parser, "--top", "programs to print of each task", default=5)
    add_seed(parser, "which demonstrations, and which other moves they are compared with")
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Infer and print, task by task."""
    import numpy as np

    from magical.demos import Dataset

    dataset = Dataset.open(args.demos)
    found = {}
    for task in args.task or dict.fromkeys(entry.task for entry in dataset.entries):
        some = dataset.filter(task=task).sample(args.num_demos, np.random.default_rng(args.seed))
        found[task] = _explain(task, list(some), args)
    print_json(args, found)
    return 0


def _explain(task: str, some: "list[Trajectory]", args: argparse.Namespace) -> dict[str, Any]:
    import numpy as np

    from magical.learning.intent.episodes import make_episode
    from magical.learning.intent.posterior import infer
    from magical.tasks import get_task
    from magical.tasks.programs.prior import Prior
    from magical.tasks.programs.suite import TRAINING, task_name

    rng = np.random.default_rng(args.seed)
    suite = [get_task(task_name(k)).program for k in TRAINING] if args.prior == "suite" else []
    prior = Prior.of(program for program in suite if program is not None)
    belief = infer([make_episode(trajectory, rng) for trajectory in some], prior)
    top = belief.explanations[: args.top]
    rows = [(f"{e.weight:.3f}", f"{prior.bits(e.program):.1f}", repr(e.program)) for e in top]
    print_table(("probability", "prior bits", task), rows)
    if not belief.is_explained:
        verdict = "no program explains the demonstrations much better than random moves"
    elif not belief.is_known:
        verdict = "not known: the demonstrations leave open which of many goals was meant"
    else:
        verdict = "known: one meaning is more probable than all others together"
    print(f"{verdict} ({belief.evidence:.1f} nats a demonstration, {belief.largest:.2f})\n")
    return {
        "programs": [[repr(e.program), e.weight] for e in top],
        "evidence": belief.evidence,
        "largest": belief.largest,
        "explained": belief.is_explained,
        "known": belief.is_known,
    }
