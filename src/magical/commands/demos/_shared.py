"""Arguments and messages that the sub-commands of `magical demos` share."""

import argparse
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from magical.commands._common import log, positive_int
from magical.messages import printable

if TYPE_CHECKING:
    from magical.demos import Problem

Subparsers = Any  # argparse does not export the class


def add_command(
    subparsers: Subparsers, name: str, run: Callable[[argparse.Namespace], int], text: str
) -> argparse.ArgumentParser:
    """Add a sub-command that calls `run`; returns its parser."""
    parser: argparse.ArgumentParser = subparsers.add_parser(name, help=text)
    parser.set_defaults(run_demos=run)
    return parser


def add_dataset(parser: argparse.ArgumentParser) -> None:
    """Add the dataset to read."""
    parser.add_argument("dataset", type=Path, metavar="DIR", help="the dataset's folder")


def add_out(parser: argparse.ArgumentParser) -> None:
    """Add the dataset to append to."""
    parser.add_argument(
        "--out", type=Path, required=True, metavar="DIR", help="dataset to append to, or to create"
    )


def add_workers(parser: argparse.ArgumentParser) -> None:
    """Add the number of processes."""
    parser.add_argument(
        "--workers", type=positive_int, metavar="K", help="processes (default: one per core)"
    )


def number(value: float | None) -> str:
    """A score for a table."""
    return "-" if value is None else f"{value:.3f}"


def names(values: Iterable[str]) -> str:
    """Names from a file for a table: they may hold any characters, and be many."""
    return printable(", ".join(values))


def log_problems(problems: "tuple[Problem, ...]") -> None:
    """Report what is wrong with a dataset on standard error."""
    for problem in problems:
        log(f"error: {problem}")
