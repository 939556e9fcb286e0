"""Print which programs of the goal language a trained policy believes in, and how strongly.

RUN is the folder of a run of `program-bc`. A program is weighted by its prior probability and by
how likely its goal makes the demonstrated moves. If Demo leaves open what was meant, many programs
share the weight; if no program explains the demonstrations, the output says so. Programs that agree
in Demo may differ elsewhere, so the confidence in scenes of each variant is printed: the
probability that what the policy would move first has to be moved.
"""

import argparse
from pathlib import Path

from magical.commands._common import add_count, add_json, print_json, print_table

HELP = "print which programs explain a run's demonstrations"


def configure(parser: argparse.ArgumentParser) -> None:
    """Describe the command's arguments."""
    parser.add_argument("folder", type=Path, metavar="RUN", help="a run folder of program-bc")
    add_count(parser, "--top", "programs to print for each task", default=5)
    meaning = "scenes of each variant to average the confidence over"
    add_count(parser, "--scenes", meaning, default=10, least=0)
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Print, task by task."""
    from magical_goals.intent.acting import confidence_by_variant
    from magical_goals.program_bc import beliefs_of

    found = {}
    for task, belief in beliefs_of(args.folder).items():
        top = belief.explanations[: args.top]
        print_table(("probability", task), [(f"{e.weight:.3f}", repr(e.program)) for e in top])
        print(f"{belief.verdict}\n")
        confidence = confidence_by_variant(belief, task, args.scenes) if args.scenes else {}
        if confidence:
            rows = [(f"{mean:.2f}", variant) for variant, mean in confidence.items()]
            print_table(("confidence", "first move in"), rows)
            print()
        found[task] = {
            "programs": [[repr(e.program), e.weight] for e in top],
            "unexplained": belief.unexplained,
            "largest": belief.largest,
            "explained": belief.is_explained,
            "known": belief.is_known,
            "confidence": confidence,
        }
    print_json(args, found)
    return 0
