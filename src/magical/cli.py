"""The `magical` command.

A command is a module with `configure(parser)` and `run(args)`, in `magical/commands/`, or with
`HELP` as well an entry point of another distribution. Exit status: 0 for success, 1 for a failed
check or an error, 2 for wrong usage, 130 for an interruption.
"""

import argparse
import importlib
import io
import os
import signal
import sys
import warnings
from collections.abc import Sequence
from contextlib import suppress
from typing import Any, NoReturn

from magical import __version__, commands
from magical.commands._common import FAILED, INTERRUPTED, USAGE, UsageError, log
from magical.errors import (
    InvalidConfigError,
    MagicalError,
    MissingDependencyError,
    PlanError,
    UnknownNameError,
)
from magical.extras import missing
from magical.plugins import load_plugin, plugins
from magical.tasks.registry import import_tasks

GROUP = "magical.commands"  # of the entry points
# The commands of the other distributions of this project.
COMPANIONS = {
    "train": "magical-baselines",
    "run": "magical-baselines",
    "status": "magical-baselines",
    "quickstart": "magical-baselines",
    "explain": "magical-goals",
    "play": "magical-play",
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit status; errors go to standard error."""
    if isinstance(sys.stdout, io.TextIOWrapper):  # a file name may contain any bytes
        sys.stdout.reconfigure(errors="backslashreplace")
    with suppress(ValueError):  # only the main thread may set handlers
        signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        with warnings.catch_warnings():
            warnings.showwarning = _show_warning
            # First, because a module may register tasks and algorithms that the others can name.
            found, words = _import_parser().parse_known_args(argv)
            for module in found.imports:
                import_tasks(module)
            words = words or ["--help"]
            arguments = build_parser(words[0]).parse_args(words)
            status = int(arguments.run(arguments))
        print(end="", flush=True)  # there may be no standard output to flush
        return status
    except SystemExit as stop:  # argparse: --help, --version, wrong usage
        return stop.code if isinstance(stop.code, int) else USAGE
    except BrokenPipeError:
        # The reader closed the pipe (`magical envs | head`); the exit's own flush must not fail.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return FAILED
    except ModuleNotFoundError as error:
        try:
            log(f"error: {missing(error.name or '')}")
        except LookupError:  # not an optional library, so a bug
            raise error from None
        return FAILED
    except (MagicalError, OSError) as error:
        log(f"error: {error}")
        wrong = isinstance(error, UnknownNameError | InvalidConfigError | PlanError | UsageError)
        return USAGE if wrong else FAILED
    except KeyboardInterrupt:
        log("interrupted")
        return INTERRUPTED


def build_parser(command: str = "") -> argparse.ArgumentParser:
    """The parser of the whole command line, or of one command if it is known.

    Raises `MissingDependencyError` for a command of a distribution that is not installed.
    """
    names = [command] if command in (*commands.HELP, *plugins(GROUP)) else find_commands()
    if command in COMPANIONS and command not in names:
        distribution = COMPANIONS[command]
        raise MissingDependencyError(
            f"magical {command}: this command is of {distribution}, which is not installed: pip "
            f"install {distribution}; in a clone of the repository: pip install "
            f"./{distribution.removeprefix('magical-')}"
        )
    description = "The MAGICAL benchmark for robust imitation learning."
    parser = _Parser(prog="magical", description=description, parents=[_import_parser()])
    parser.add_argument("--version", action="version", version=f"magical {__version__}")
    subparsers = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for name in names:
        sub = subparsers.add_parser(name, help=_help(name))
        if command in ("", name):
            module = _module(name)
            module.configure(sub)
            sub.description = module.__doc__
            sub.set_defaults(run=module.run)
    return parser


def find_commands() -> dict[str, str]:
    """The help of every command in a line, by name, alphabetically."""
    return {name: _help(name) for name in sorted({*commands.HELP, *plugins(GROUP)})}


def _help(name: str) -> str:
    return commands.HELP.get(name) or str(_module(name).HELP)


def _module(name: str) -> Any:
    if name in commands.HELP:
        return importlib.import_module(f"{commands.__name__}.{name}")
    return load_plugin(GROUP, name)


class _Parser(argparse.ArgumentParser):
    """A parser, also of each command, without abbreviations; reports an error in one line."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(allow_abbrev=False, **settings)

    def error(self, message: str) -> NoReturn:
        """Exit with the status of wrong usage."""
        self.exit(USAGE, f"error: {message}; see {self.prog} --help\n")


def _import_parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="magical", add_help=False)
    meaning = (
        "with any command: first import a module or a .py file, such as one that registers a "
        "task; may be repeated"
    )
    names: dict[str, Any] = {"dest": "imports", "metavar": "MODULE", "default": []}
    parser.add_argument("--import", action="append", help=meaning, **names)
    return parser


def _show_warning(message: Warning | str, *_: Any, **__: Any) -> None:
    """Print a warning in one line, without the place in the code that it comes from."""
    log(f"warning: {' '.join(str(message).split())}")
