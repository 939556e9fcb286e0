"""From nothing to a result: an episode in each task, and a picture of all scenes."""

import argparse
from pathlib import Path

from magical.commands._common import log, non_negative_int, print_table, write_image

HELP = "the package's main job, from nothing to a result"


def configure(parser: argparse.ArgumentParser) -> None:
    """Describe the command's arguments."""
    parser.add_argument("--out", type=Path, default=Path("runs/quickstart"), metavar="DIR")
    parser.add_argument("--seed", type=non_negative_int, default=0)


def run(args: argparse.Namespace) -> int:
    """Run, print, draw."""
    from magical.evaluation import by_variant, environments, evaluate, load_policy
    from magical.report import contact_sheet

    demos = environments(variants=["Demo"])
    policies = ["noop", "random", "expert"]
    results = {
        name: by_variant(evaluate(load_policy(name), demos, rollouts=1, seed=args.seed))
        for name in policies
    }
    rows = [
        (task, *(results[name][task]["Demo"][0].score for name in policies))
        for task in results["random"]
    ]
    print_table(("one episode of", *policies), rows)
    sheet = args.out / "contact-sheet.png"
    write_image(sheet, contact_sheet(seed=args.seed))
    log(f"wrote {sheet}: the scenes of all {len(environments())} environments")
    return 0
