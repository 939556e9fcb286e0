"""Shared by the commands: JSON results, tables, messages, images, argument types."""

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from magical.files import write_atomically


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


def add_seed(parser: argparse.ArgumentParser, meaning: str) -> None:
    """Add `--seed N`, 0 or more."""
    parser.add_argument(
        "--seed", type=non_negative_int, default=0, metavar="N", help=f"{meaning} (default: 0)"
    )


def add_rollouts(parser: argparse.ArgumentParser, default: int = 100) -> None:
    """Add `--rollouts N`, on each variant."""
    parser.add_argument(
        "--rollouts",
        type=positive_int,
        default=default,
        metavar="N",
        help=f"on each variant (default: {default})",
    )


def add_workers(parser: argparse.ArgumentParser) -> None:
    """Add `--workers N`; `args.workers` is `None` for the number of cores."""
    parser.add_argument(
        "--workers", type=non_negative_int, metavar="N", help="processes (default: the cores)"
    )


def print_json(result: Mapping[str, Any]) -> None:
    """Print the one JSON object that `--json` promises."""
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


def write_image(path: Path, pixels: NDArray[np.uint8]) -> None:
    """Write an (H, W, 3) image as PNG, atomically.

    Raises:
        OSError: the folder cannot be made or written to.
    """
    from PIL import Image

    with write_atomically(path) as file:
        Image.fromarray(pixels).save(file, format="PNG")


def non_negative_int(text: str) -> int:
    """An argparse type: an integer of at least 0."""
    return _at_least(0, text)


def positive_int(text: str) -> int:
    """An argparse type: an integer of at least 1."""
    return _at_least(1, text)


def fraction(text: str) -> float:
    """An argparse type: a number from 0 to 1."""
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0.0 <= value <= 1.0:
        raise argparse.ArgumentTypeError(f"expected a number from 0 to 1, found {text!r}")
    return value


def _at_least(least: int, text: str) -> int:
    try:
        value = int(text)
    except ValueError:
        value = least - 1
    if value < least:
        raise argparse.ArgumentTypeError(f"expected an integer of at least {least}, found {text!r}")
    return value
