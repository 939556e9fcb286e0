"""Show the progress of `magical run`, from another terminal or after it has ended."""

import argparse
from pathlib import Path

from magical.commands._common import add_json, print_json, print_table

HELP = "show the progress of a plan"


def configure(parser: argparse.ArgumentParser) -> None:
    """Describe the command's arguments."""
    parser.add_argument("folder", type=Path, metavar="DIR", help="the results folder")
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Read the folder, print the state of every run."""
    from magical_baselines.experiments.status import read_status

    status = read_status(args.folder)
    print_table(("run", "state", "progress"), [(r, r.state, r.progress) for r in status.runs])
    print(status)
    print_json(args, status.to_dict())
    return 0
