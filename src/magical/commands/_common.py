"""Shared by the commands: options, JSON results, tables, messages."""

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any


def add_json(parser: argparse.ArgumentParser) -> None:
    """Add `--json`: the last line of standard output is one JSON object."""
    parser.add_argument(
        "--json", action="store_true", help="end standard output with one line of JSON"
    )


def add_tasks(parser: argparse.ArgumentParser, default: str = "all") -> None:
    """Add `--task A B`; `args.task` is a list of names, or `None` for the default."""
    parser.add_argument(
        "--task",
        nargs="+",
        action="extend",
        type=task_name,
        metavar="TASK",
        help=f"or module:TASK (default: {default})",
    )


def task_name(text: str) -> str:
    """A task's name; of `module:TASK`, which is imported, its own name."""
    if ":" not in text:
        return text
    from magical.errors import MagicalError
    from magical.tasks import load_task

    try:
        return load_task(text).name
    except MagicalError as error:
        raise argparse.ArgumentTypeError(str(error)) from error


def add_count(
    parser: argparse.ArgumentParser,
    flag: str,
    meaning: str,
    *,
    default: int | None = None,
    least: int = 1,
    metavar: str = "N",
    nargs: str | None = None,
) -> None:
    """Add an option whose value is an integer of at least `least`; the help says the default."""

    def integer(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            value = least - 1
        if value < least:
            raise argparse.ArgumentTypeError(
                f"expected an integer of at least {least}, found {text!r}"
            )
        return value

    stated = "" if default is None else f" (default: {default})"
    parser.add_argument(
        flag, type=integer, default=default, metavar=metavar, nargs=nargs, help=meaning + stated
    )


def add_seed(parser: argparse.ArgumentParser, meaning: str) -> None:
    """Add `--seed N`, 0 or more."""
    add_count(parser, "--seed", meaning, default=0, least=0)


def add_rollouts(parser: argparse.ArgumentParser) -> None:
    """Add `--rollouts N`, on each variant."""
    add_count(parser, "--rollouts", "on each variant", default=100)


def add_workers(parser: argparse.ArgumentParser, least: int = 0) -> None:
    """Add `--workers N`; `args.workers` is `None` for the number of cores."""
    add_count(parser, "--workers", "processes (default: the cores)", least=least)


def add_out(
    parser: argparse.ArgumentParser, meaning: str, metavar: str = "DIR", *, required: bool = False
) -> None:
    """Add `--out`, a path."""
    parser.add_argument("--out", type=Path, required=required, metavar=metavar, help=meaning)


def print_json(args: argparse.Namespace, result: Mapping[str, Any]) -> None:
    """Print the one JSON object that `--json` promises, where it is given."""
    if args.json:
        print(json.dumps(result))


def log(message: str) -> None:
    """Print a message that is not the result, on standard error."""
    print(message, file=sys.stderr)


def print_table(header: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    """Print a table in aligned columns; columns of numbers are aligned to the right."""
    cells = [[str(cell) for cell in row] for row in rows]
    widths = [max(map(len, column)) for column in zip(header, *cells, strict=True)]
    columns = list(zip(*cells, strict=True)) or [()] * len(header)
    numeric = [bool(column) and all(map(_is_number, column)) for column in columns]
    for line in [list(header), ["-" * width for width in widths], *cells]:
        padded = [
            cell.rjust(width) if right else cell.ljust(width)
            for cell, width, right in zip(line, widths, numeric, strict=True)
        ]
        print("  ".join(padded).rstrip())


def _is_number(cell: str) -> bool:
    try:
        float(cell or "0")
    except ValueError:
        return False
    return True


def fraction(text: str) -> float:
    """An argparse type: a number from 0 to 1."""
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0.0 <= value <= 1.0:
        raise argparse.ArgumentTypeError(f"expected a number from 0 to 1, found {text!r}")
    return value
