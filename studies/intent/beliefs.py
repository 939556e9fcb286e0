"""What is believed of the paper's tasks after ten demonstrations: a table, and a picture.

python -m studies.intent.beliefs --demos FOLDER [--picture FILE]
"""

import argparse
from pathlib import Path

from magical.tasks import TASKS
from magical_baselines.data.expert_data import sample_demonstrations
from magical_goals.intent.posterior import Belief
from magical_goals.language.programs import program_of
from magical_goals.objects.data import parse_demonstrations
from magical_goals.objects.parser import parse_frames
from magical_goals.program_bc import ProgramBCConfig, infer_beliefs
from studies.intent.picture import draw_beliefs
from tools.readme_tables import table

DEMONSTRATIONS = 10


def row(task: str, belief: Belief) -> list[str]:
    """A task's line: what it is, how probable that is, and what is more probable."""
    truth = repr(program_of(task))
    weights = {repr(program): weight for program, weight in belief.explanations}
    first = repr(belief.explanations[0].program)
    return [
        task,
        f"`{truth}`",
        f"{weights.get(truth, 0.0):.2f}",
        "the same" if first == truth else f"`{first}`",
        f"{belief.explanations[0].weight:.2f}",
        f"{belief.largest:.2f}",
        f"{belief.unexplained:.2f}",
    ]


def main() -> None:
    """Infer, print and draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--demos", required=True)
    parser.add_argument("--picture", type=Path)
    args = parser.parse_args()
    config = ProgramBCConfig.preset("quick", tasks=tuple(TASKS), demos=args.demos)
    sampled = sample_demonstrations(args.demos, config.tasks, DEMONSTRATIONS, config.seed)
    beliefs = infer_beliefs(config, parse_demonstrations(sampled.trajectories, parse_frames))
    header = ("Task", "Its program", "p", "The most probable one", "p", "Its meaning", "None")
    print(table(header, (row(task, belief) for task, belief in beliefs.items())))
    if args.picture:
        draw_beliefs(beliefs, args.picture)


if __name__ == "__main__":
    main()
