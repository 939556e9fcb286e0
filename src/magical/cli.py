"""The `magical` command.

A command is a file in `magical/commands/` with `HELP`, `configure(parser)` and `run(args)`; the
file's name is the command's. Other distributions add theirs by entry points. Commands are listed in
alphabetical order. Exit status: 0 for success,
1 for a failed check or an error, 2 for wrong usage, 130 for an interruption.
"""

import argparse
import importlib
import io
import os
import pkgutil
import signal
import sys
import threading
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from types import ModuleType
from typing import Any, NoReturn

from magical import __version__, commands
from magical.commands._common import FAILED, INTERRUPTED, USAGE, UsageError
from magical.errors import MagicalError, MissingDependencyError, PlanError, UnknownNameError
from magical.extras import missing
from magical.messages import for_terminal
from magical.plugins import load_plugin, plugins
from magical.tasks.registry import import_tasks

GROUP = "magical.commands"  # of the entry points, each a module like those in `magical/commands`
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
    try:
        with _termination_as_interrupt(), warnings.catch_warnings():
            warnings.showwarning = _show_warning
            words = _import_modules(argv) or ["--help"]
            _require_companion(words)
            arguments = build_parser(words[0]).parse_args(words)
            status = int(arguments.run(arguments))
        print(end="", flush=True)  # there may be no standard output to flush
    except SystemExit as stop:  # argparse: --help, --version, wrong usage
        return stop.code if isinstance(stop.code, int) else USAGE
    except (UnknownNameError, PlanError, UsageError) as error:
        return _report(error, USAGE)
    except BrokenPipeError:
        # The reader closed the pipe (`magical envs | head`); the exit's own flush must not fail.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return FAILED
    except ModuleNotFoundError as error:
        try:
            return _report(missing(error.name or ""), FAILED)
        except LookupError:  # not an optional library, so a bug
            raise error from None
    except (MagicalError, OSError) as error:
        return _report(error, FAILED)
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return INTERRUPTED
    return status


@contextmanager
def _termination_as_interrupt() -> Iterator[None]:
    """SIGTERM raises `KeyboardInterrupt`, as Ctrl-C does, unless something else handles it."""
    ours = (
        threading.current_thread() is threading.main_thread()  # only it may set handlers
        and signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    )
    if ours:
        signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        if ours:
            signal.signal(signal.SIGTERM, signal.SIG_DFL)


def build_parser(command: str = "") -> argparse.ArgumentParser:
    """The parser of the whole command line, or of one command if it is known."""
    parser = _Parser(
        prog="magical", description="The MAGICAL benchmark for robust imitation learning."
    )
    parser.add_argument("--version", action="version", version=f"magical {__version__}")
    _add_import(parser)
    parser.add_argument("--env-name", action=_PublishedOption, help=argparse.SUPPRESS)
    subparsers = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for name, module in find_commands(command).items():
        sub = subparsers.add_parser(name, help=module.HELP, description=module.__doc__)
        if command in ("", name):
            module.configure(sub)
            sub.set_defaults(run=module.run)
    return parser


class _Parser(argparse.ArgumentParser):
    """A parser that accepts no abbreviated options, and reports an error in one line.

    Its commands' parsers are of this class too.
    """

    def __init__(self, **settings: Any) -> None:
        super().__init__(allow_abbrev=False, **settings)

    def error(self, message: str) -> NoReturn:
        """See `argparse.ArgumentParser.error`."""
        self.exit(USAGE, f"error: {message}; see {self.prog} --help\n")


class _PublishedOption(argparse.Action):
    """The only option of the published package, whose `python -m magical` was for playing."""

    def __call__(self, parser: argparse.ArgumentParser, *args: Any, **kwargs: Any) -> NoReturn:
        parser.error("--env-name is of the published package only; use `magical play --env ID`")


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
    parser.add_argument(
        "--import",
        dest="imports",
        action="append",
        default=[],
        metavar="MODULE",
        help="with any command: first import a module or a .py file, such as one that registers "
        "a task; may be repeated",
    )


def find_commands(command: str = "") -> dict[str, ModuleType]:
    """Every command's module by name, alphabetically, or only that of one if it is known.

    Files whose names begin with an underscore are helpers.
    """
    files = [entry.name for entry in pkgutil.iter_modules(commands.__path__)]
    names = sorted({*plugins(GROUP), *(name for name in files if not name.startswith("_"))})
    return {
        name: importlib.import_module(f"{commands.__name__}.{name}")
        if name in files
        else load_plugin(GROUP, name)
        for name in ([command] if command in names else names)
    }


def _require_companion(words: Sequence[str]) -> None:
    """Raise `MissingDependencyError` if a command is that of a distribution not installed."""
    distribution = COMPANIONS.get(words[0]) if words else None
    if distribution and words[0] not in plugins(GROUP):
        raise MissingDependencyError(
            f"magical {words[0]}: this command is of {distribution}, which is not installed: pip "
            f"install {distribution}; in a clone of the repository: pip install "
            f"./{distribution.removeprefix('magical-')}"
        )


def _show_warning(message: Warning | str, *_: Any, **__: Any) -> None:
    """Print a warning in one line, without the place in the code that it comes from."""
    print(f"warning: {' '.join(str(message).split())}", file=sys.stderr)


def _report(error: Exception | str, status: int) -> int:
    print(for_terminal(f"error: {error}"), file=sys.stderr)
    return status
