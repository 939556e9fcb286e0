"""Shared by the commands: options, JSON results, tables, messages."""

import argparse
import json
import math
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar

from magical.errors import MagicalError
from magical.messages import for_terminal, quoted

FAILED, USAGE, INTERRUPTED = 1, 2, 130  # exit statuses

Number = TypeVar("Number", int, float)
Value = TypeVar("Value")


class UsageError(MagicalError):
    """Wrong options, or options that exclude or need each other; the exit status is `USAGE`."""


def add_json(parser: argparse.ArgumentParser) -> None:
    """Add `--json`: the last line of standard output is one JSON object."""
    parser.add_argument(
        "--json",
        action="store_true",
        help="print a JSON object as the last line of standard output",
    )


def add_tasks(parser: argparse.ArgumentParser, default: str = "all") -> None:
    """Add `--task A B`; `args.task` is a list of names, or `None` for the default."""
    meaning = f"tasks, by name or as module:TASK (default: {default})"
    add_several(parser, "--task", meaning, "TASK", kind=task_name)


def add_several(
    parser: argparse.ArgumentParser,
    flag: str,
    meaning: str,
    metavar: str,
    *,
    kind: Callable[[str], Any] = str,
    **options: Any,
) -> None:
    """Add a repeatable option with several values; it gives a list of what `kind` returns."""
    options |= {"metavar": metavar, "help": meaning}
    parser.add_argument(flag, nargs="+", action="extend", type=kind, **options)


def task_name(text: str) -> str:
    """A task's name; `module:TASK` is imported, and the name is that of the task."""
    if ":" not in text:
        return text
    from magical.tasks import load_task

    return explained(load_task)(text).name


def explained(parse: Callable[[str], Value]) -> Callable[[str], Value]:
    """An argparse type from a function whose errors say what was expected."""

    def parsed(text: str) -> Value:
        try:
            return parse(text)
        except MagicalError as error:
            raise argparse.ArgumentTypeError(str(error)) from error

    return parsed


def number(kind: type[Number], least: float, most: float = math.inf) -> Callable[[str], Number]:
    """An argparse type: a finite number or an integer in a range that includes its ends."""
    noun = "an integer" if kind is int else "a number"
    allowed = f"of at least {least:g}" if most == math.inf else f"from {least:g} to {most:g}"

    def parsed(text: str) -> Number:
        with suppress(ValueError, OverflowError):
            value = kind(text)
            if least <= value <= most and math.isfinite(value):
                return value
        raise argparse.ArgumentTypeError(f"expected {noun} {allowed}, found {text!r}")

    return parsed


def add_count(
    parser: argparse.ArgumentParser,
    flag: str,
    meaning: str,
    *,
    default: int | None = None,
    least: int = 1,
    metavar: str = "N",
) -> None:
    """Add an option whose value is an integer of at least `least`; the help states the default."""
    kind, stated = number(int, least), "" if default is None else f" (default: {default})"
    parser.add_argument(flag, type=kind, default=default, metavar=metavar, help=meaning + stated)


def add_number(
    parser: argparse.ArgumentParser,
    flag: str,
    meaning: str,
    *,
    default: float | None = 0.0,
    most: float = math.inf,
    metavar: str = "X",
) -> None:
    """Add an option whose value is a number from 0 to `most`; the help states the default."""
    kind, stated = number(float, 0, most), "" if default is None else f" (default: {default:g})"
    parser.add_argument(flag, type=kind, default=default, metavar=metavar, help=meaning + stated)


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
    kind = file_path if metavar.startswith("FILE") else Path
    parser.add_argument("--out", type=kind, required=required, metavar=metavar, help=meaning)


def file_path(text: str) -> Path:
    """An argparse type: the path of a file, which need not exist."""
    if Path(text).is_dir():
        raise argparse.ArgumentTypeError(f"expected a file, found the folder {quoted(text)}")
    return Path(text)


def print_json(args: argparse.Namespace, result: Mapping[str, Any]) -> None:
    """Print the one JSON object that `--json` promises, if it was given."""
    if args.json:
        print(json.dumps(result))


def plain_interval(interval: Iterable[float]) -> list[float | None]:
    """A value and the ends of its interval for JSON; NaN becomes `None`."""
    return [None if math.isnan(number) else number for number in interval]


def log(message: str) -> None:
    """Print a message that is not the result, on standard error."""
    print(for_terminal(message), file=sys.stderr)


def print_table(header: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    """Print a table in aligned columns; columns of numbers are aligned to the right."""
    cells = [[for_terminal(str(cell)) for cell in row] for row in rows]
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
        float(cell.replace("−", "-") or "0")
    except ValueError:
        return False
    return True
