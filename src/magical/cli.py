"""The `magical` command.

A command is a module with `HELP`, `configure(parser)` and `run(args)`: a file in
`magical/commands/`, or an entry point of another distribution. Exit status: 0 for success,
1 for a failed check or an error, 2 for wrong usage, 130 for an interruption.
"""

import argparse
import importlib
import io
import os
import pkgutil
import signal
import sys
import warnings
from collections.abc import Sequence
from contextlib import suppress
from types import ModuleType
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
            words = _import_modules(argv) or ["--help"]
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
    """The parser of the whole command line, or of one command if it is known."""
    parser = _Parser(
        prog="magical", description="The MAGICAL benchmark for robust imitation learning."
    )
    parser.add_argument("--version", action="version", version=f"magical {__version__}")
    _add_import(parser)
    subparsers = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for name, module in find_commands(command).items():
        sub = subparsers.add_parser(name, help=module.HELP, description=module.__doc__)
        if command in ("", name):
            module.configure(sub)
            sub.set_defaults(run=module.run)
    return parser


class _Parser(argparse.ArgumentParser):
    """A parser that takes no abbreviated options, and reports an error in one line.

    Its commands' parsers are of this class too.
    """

    def __init__(self, **settings: Any) -> None:
        super().__init__(allow_abbrev=False, **settings)

    def error(self, message: str) -> NoReturn:
        """Exit with the status of wrong usage."""
        self.exit(USAGE, f"error: {message}; see {self.prog} --help\n")


def _import_modules(argv: Sequence[str] | None) -> list[str]:
    """Import what `--import` names, anywhere in the arguments, and return the other arguments.

    This comes first because a module may register tasks and algorithms that the others can name.
    """
    parser = _Parser(prog="magical", add_help=False)
    _add_import(parser)
    found, rest = parser.parse_known_args(argv)
    for module in found.imports:
        import_tasks(module)
    return rest


def _add_import(parser: argparse.ArgumentParser) -> None:
    meaning = (
        "with any command: first import a module or a .py file, such as one that registers a "
        "task; may be repeated"
    )
    parser.add_argument(
        "--import", dest="imports", action="append", default=[], metavar="MODULE", help=meaning
    )


def find_commands(command: str = "") -> dict[str, ModuleType]:
    """Every command's module by name, alphabetically, or only that of one if it is known.

    Raises `MissingDependencyError` for a command of a distribution that is not installed.
    """
    own = [module.name for module in pkgutil.iter_modules(commands.__path__)]
    names = sorted({*plugins(GROUP), *(name for name in own if not name.startswith("_"))})
    if command in COMPANIONS and command not in names:
        distribution = COMPANIONS[command]
        raise MissingDependencyError(
            f"magical {command}: this command is of {distribution}, which is not installed: pip "
            f"install {distribution}; in a clone of the repository: pip install "
            f"./{distribution.removeprefix('magical-')}"
        )
    return {
        name: importlib.import_module(f"{commands.__name__}.{name}")
        if name in own
        else load_plugin(GROUP, name)
        for name in ([command] if command in names else names)
    }


def _show_warning(message: Warning | str, *_: Any, **__: Any) -> None:
    """Print a warning in one line, without the place in the code that it comes from."""
    log(f"warning: {' '.join(str(message).split())}")
