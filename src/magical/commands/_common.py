"""Shared by the commands: options, JSON results, tables, messages."""

import argparse
import json
import math
import re
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from magical.errors import MagicalError
from magical.messages import for_terminal, quoted

FAILED, USAGE, INTERRUPTED = 1, 2, 130  # exit statuses
NUMBER = re.compile(r"[-−+]?[\d.]*|nan")  # in a cell of a table


class UsageError(MagicalError):
    """Wrong options, or options that exclude or need each other; the exit status is `USAGE`."""


def add_json(parser: argparse.ArgumentParser) -> None:
    """Add `--json`: the last line of standard output is one JSON object."""
    meaning = "print a JSON object as the last line of standard output"
    parser.add_argument("--json", action="store_true", help=meaning)


def add_several(
    parser: argparse.ArgumentParser, flag: str, meaning: str, metavar: str, **options: Any
) -> None:
    """Add an option with several values, which may be repeated; it gives one list."""
    options = {"nargs": "+", "type": options.pop("kind", str), **options}
    parser.add_argument(flag, action="extend", metavar=metavar, help=meaning, **options)


def add_tasks(parser: argparse.ArgumentParser, default: str) -> None:
    """Add `--task A B`; `args.task` is a list of names, or `None` for the default."""
    meaning = f"tasks, by name or as module:TASK (default: {default})"
    add_several(parser, "--task", meaning, "TASK", kind=task_name)


def task_name(text: str) -> str:
    """A task's name; `module:TASK` is imported, and the name is that of the task."""
    from magical.tasks import load_task

    try:
        return load_task(text).name if ":" in text else text
    except MagicalError as error:
        raise argparse.ArgumentTypeError(str(error)) from error


def add_number(
    parser: argparse.ArgumentParser,
    flag: str,
    meaning: str,
    *,
    default: float | None = 0.0,
    least: float = 0,
    most: float = math.inf,
    kind: type[float] = float,
    metavar: str = "X",
) -> None:
    """Add an option whose value is a finite number of a kind, in a range with its ends."""
    noun = "an integer" if kind is int else "a number"
    allowed = f"of at least {least:g}" if most == math.inf else f"from {least:g} to {most:g}"

    def parsed(text: str) -> float:
        with suppress(ValueError, OverflowError):
            value = kind(text)
            if least <= value <= most and math.isfinite(value):
                return value
        raise argparse.ArgumentTypeError(f"expected {noun} {allowed}, found {text!r}")

    meaning += "" if default is None else f" (default: {default:g})"
    parser.add_argument(flag, type=parsed, default=default, metavar=metavar, help=meaning)


def add_count(
    parser: argparse.ArgumentParser, flag: str, meaning: str, least: float = 1, **options: Any
) -> None:
    """Add an option whose value is an integer of at least `least`, by default `None`."""
    options = {"default": None, "metavar": "N", **options}
    add_number(parser, flag, meaning, least=least, kind=int, **options)


def add_seed(parser: argparse.ArgumentParser, meaning: str) -> None:
    """Add `--seed N`, 0 or more."""
    add_count(parser, "--seed", meaning, default=0, least=0)


def add_rollouts(parser: argparse.ArgumentParser) -> None:
    """Add `--rollouts N`, the number of rollouts on each variant."""
    add_count(parser, "--rollouts", "rollouts on each variant", default=100)


def add_workers(parser: argparse.ArgumentParser) -> None:
    """Add `--workers N`; `args.workers` is `None` for the number of cores."""
    add_count(parser, "--workers", "worker processes (default: one per core)", least=0)


def add_out(
    parser: argparse.ArgumentParser, meaning: str, metavar: str = "DIR", *, required: bool = False
) -> None:
    """Add `--out`, a path; one whose `metavar` begins with FILE must not be a folder."""

    def parsed(text: str) -> Path:
        if metavar.startswith("FILE") and Path(text).is_dir():
            raise argparse.ArgumentTypeError(f"expected a file, found the folder {quoted(text)}")
        return Path(text)

    parser.add_argument("--out", type=parsed, required=required, metavar=metavar, help=meaning)


def print_json(args: argparse.Namespace, result: Mapping[str, Any]) -> None:
    """Print the one JSON object that `--json` promises, if it was given."""
    if args.json:
        print(json.dumps(result))


def log(message: str) -> None:
    """Print a message that is not the result, on standard error."""
    print(for_terminal(message), file=sys.stderr)


def print_table(header: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    """Print a table in aligned columns; columns of numbers are aligned to the right.

    Floats are printed with three decimals, `None` as `-`, and lists with commas.
    """

    def text(cell: object) -> str:
        if isinstance(cell, list | tuple):
            return ", ".join(map(str, cell))
        return "-" if cell is None else f"{cell:.3f}" if isinstance(cell, float) else str(cell)

    cells = [[for_terminal(text(cell)) for cell in row] for row in rows]
    aligned = []
    for column in zip(header, *cells, strict=True):
        numeric = bool(cells) and all(map(NUMBER.fullmatch, column[1:]))
        width = max(map(len, column))
        column = (column[0], "-" * width, *column[1:])
        aligned.append([f"{cell:{'>' if numeric else '<'}{width}}" for cell in column])
    for line in zip(*aligned, strict=True):
        print("  ".join(line).rstrip())


def print_records(records: Sequence[Mapping[str, object]]) -> None:
    """Print a table with a row for each record; all have the same keys."""
    if records:
        print_table(list(records[0]), [list(record.values()) for record in records])
