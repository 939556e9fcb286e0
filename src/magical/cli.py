"""The `magical` command.

A command is a file in `magical/commands/` with `HELP`, `configure(parser)` and `run(args)`; the
file's name is the command's. Commands are listed in alphabetical order. Exit status: 0 good, 1 a
check failed or an error was met, 2 wrong usage, 130 interrupted.
"""

import argparse
import importlib
import os
import pkgutil
import sys
from collections.abc import Iterator, Sequence
from types import ModuleType

from magical import __version__, commands
from magical.errors import MagicalError, PlanError, UnknownNameError

GOOD, FAILED, USAGE, INTERRUPTED = 0, 1, 2, 130

# Which extra of the package brings an optional library.
EXTRAS = {
    **dict.fromkeys(("safetensors", "torch"), "learning"),
    **dict.fromkeys(("jinja2", "matplotlib"), "report"),
    **dict.fromkeys(("imageio", "imageio_ffmpeg"), "video"),
    **dict.fromkeys(("h5py", "minari"), "minari"),
    **dict.fromkeys(("av", "pyarrow"), "lerobot"),
    **dict.fromkeys(("starlette", "uvicorn", "websockets"), "web"),
    "pygame": "window",
    "ray": "ray",
    "stable_baselines3": "sb3",
    "tensorboard": "tensorboard",
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit status; errors go to standard error."""
    try:
        arguments = build_parser().parse_args(argv)
        status = int(arguments.run(arguments))
        sys.stdout.flush()
    except SystemExit as stop:  # argparse: --help, --version, wrong usage
        return stop.code if isinstance(stop.code, int) else USAGE
    except (UnknownNameError, PlanError) as error:
        return _report(error, USAGE)
    except BrokenPipeError:
        # The reader closed the pipe (`magical envs | head`); the exit's own flush must not fail.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return FAILED
    except ModuleNotFoundError as error:
        return _report(_missing(error), FAILED)
    except (MagicalError, OSError) as error:
        return _report(error, FAILED)
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return INTERRUPTED
    return status


def build_parser() -> argparse.ArgumentParser:
    """The parser of the whole command line."""
    parser = argparse.ArgumentParser(
        prog="magical", description="The MAGICAL benchmark for robust imitation learning."
    )
    parser.add_argument("--version", action="version", version=f"magical {__version__}")
    subparsers = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for name, module in find_commands():
        sub = subparsers.add_parser(name, help=module.HELP, description=module.__doc__)
        module.configure(sub)
        sub.set_defaults(run=module.run)
    return parser


def find_commands() -> Iterator[tuple[str, ModuleType]]:
    """Every command's name and module, alphabetically; names with an underscore are helpers."""
    for name in sorted(entry.name for entry in pkgutil.iter_modules(commands.__path__)):
        if not name.startswith("_"):
            yield name, importlib.import_module(f"{commands.__name__}.{name}")


def _missing(error: ModuleNotFoundError) -> str:
    """What to install; a missing module that is no optional library is a bug and raised again."""
    extra = EXTRAS.get((error.name or "").partition(".")[0])
    if extra is None:
        raise error
    return f"this needs {error.name}, not installed: pip install 'magical-benchmark[{extra}]'"


def _report(error: Exception | str, status: int) -> int:
    print(f"error: {error}", file=sys.stderr)
    return status
