"""Train a policy with one of the algorithms, each of which has its own options.

A run is kept in a folder: configuration, versions, names and SHA-256 sums of the demonstrations,
metrics, a checkpoint.
"""

import argparse
import shlex
from collections.abc import Mapping
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from magical.commands._common import (
    INTERRUPTED,
    UsageError,
    add_count,
    add_json,
    add_out,
    add_several,
    log,
    print_json,
    task_name,
)
from magical.errors import PluginError

if TYPE_CHECKING:
    from magical.learning.config import Config, Option

HELP = "train a policy"


def configure(parser: argparse.ArgumentParser) -> None:
    """Describe the command's arguments without importing an algorithm, and so PyTorch."""
    from magical.learning import algorithm_names

    parser.add_argument(
        "algorithm",
        metavar="ALGORITHM",
        help=f"one of {', '.join(algorithm_names())}; or module:NAME",
    )
    parser.add_argument(
        "options",
        nargs=argparse.REMAINDER,
        action=_ParseOptions,
        default=argparse.SUPPRESS,
        metavar="...",
        help="the algorithm's options: see magical train ALGORITHM --help",
    )


def run(args: argparse.Namespace) -> int:
    """Train, or resume."""
    from magical.errors import InvalidConfigError
    from magical.learning import train
    from magical.report.figures import save_learning_curves

    def plot_at_evaluations(step: int, metrics: Mapping[str, float | str]) -> None:
        if "evaluation_score" in metrics:
            save_learning_curves(args.out)

    try:
        config = _config(args)
    except InvalidConfigError as error:  # wrong arguments, not a failure
        raise UsageError(str(error)) from error
    result = train(
        config,
        args.out,
        resume=args.resume,
        stop_after=args.stop_after,
        progress=True,
        callback=plot_at_evaluations,
        track=args.track,
    )
    save_learning_curves(args.out)
    print_json(args, result.summary())
    folder, imports = shlex.quote(str(result.folder)), _imports(config)
    if result.finished:
        log(f"{result.folder}: finished; to evaluate: magical evaluate {folder}{imports}")
        return 0
    tracks = f" --track {shlex.join(args.track)}" if args.track else ""
    demos = getattr(args, _dest("demos"), None)  # moved since the run began, where it is resumed
    moved = f" --demos {shlex.quote(str(demos))}" if args.resume and demos else ""
    again = f"magical train {args.algorithm} --out {folder} --resume{moved}{tracks}{imports}"
    log(f"{result.folder}: stopped at step {result.step}; to continue: {again}")
    return INTERRUPTED if result.interrupted else 0


def _imports(config: "Config") -> str:
    """`--import` for each module that the configuration names, which new processes need."""
    from magical.envs.vector.workers import defining_modules
    from magical.errors import InvalidTaskError
    from magical.learning.algorithms import modules_of
    from magical.tasks import get_task

    modules = dict.fromkeys(modules_of(config))
    with suppress(InvalidTaskError):  # no module can be named, but the run has been trained
        modules |= dict.fromkeys(defining_modules([get_task(name) for name in config.tasks]))
    return "".join(f" --import {shlex.quote(module)}" for module in modules)


class _ParseOptions(argparse.Action):
    """Parses what follows the algorithm's name as the options of its configuration."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: Any,
        option_string: str | None = None,
    ) -> None:
        """See `argparse.Action`."""
        options = type(parser)(
            prog=f"{parser.prog} {namespace.algorithm}",
            argument_default=argparse.SUPPRESS,  # the preset's value is used
        )
        _add_options(options, namespace.algorithm)
        options.parse_args(values, namespace)


def _add_options(parser: argparse.ArgumentParser, algorithm: str) -> None:
    from magical.learning import find_algorithm
    from magical.learning.config import options
    from magical.learning.trackers import TRACKERS

    kind = find_algorithm(algorithm).config
    parser.description = (kind.__doc__ or "").splitlines()[0]
    add_out(parser, "run folder, new or empty unless with --resume", "RUN", required=True)
    parser.add_argument(
        "--resume",
        action="store_true",
        default=False,
        help="resume the run in the folder; its configuration need not be given again",
    )
    parser.add_argument(
        "--preset",
        choices=tuple(kind.presets),
        default=None,
        help="preset for all options that are not given (default: paper)",
    )
    add_count(parser, "--stop-after", "save a checkpoint and stop after N more batches or updates")
    meaning = "also log the metrics to these trackers"
    shown = f"{{{','.join(TRACKERS)}}}"
    add_several(parser, "--track", meaning, shown, choices=TRACKERS, default=[])
    add_json(parser)
    parser.set_defaults(json=False)
    for option in options(kind):
        try:
            _add_option(parser, option)
        except argparse.ArgumentError as error:  # of another distribution's configuration
            raise PluginError(
                f"{kind.__name__}, {option.name}: `magical train` has an option {option.flag} of "
                "its own; give option() another name"
            ) from error


def _add_option(parser: argparse.ArgumentParser, option: "Option") -> None:
    """Add the option of a configuration field."""
    stated = not option.required and option.default not in (None, "", ())
    text = f"{option.help} (paper: {_shown(option.default)})" if stated else option.help
    flags = ["--task", "--tasks"] if option.name == "tasks" else [option.flag]
    if option.kind is bool:
        parser.add_argument(
            *flags, action=argparse.BooleanOptionalAction, dest=_dest(option.name), help=text
        )
        return
    parser.add_argument(
        *flags,
        action="extend" if option.several else "store",
        dest=_dest(option.name),
        type=task_name if option.name == "tasks" else option.kind,
        nargs="+" if option.several else None,
        choices=None if option.open else option.choices or None,
        metavar=f"{{{','.join(option.choices)}}}" if option.open else option.metavar,
        help=f"{text}; or module:NAME" if option.open else text,
    )


def _dest(name: str) -> str:
    """An option's name among the parsed arguments, distinct from those of the command itself."""
    return f"setting {name}"


def _shown(value: object) -> object:
    return " ".join(map(str, value)) if isinstance(value, tuple) else value


def _config(args: argparse.Namespace) -> "Config":
    """The preset's or the resumed run's configuration, with the given options replaced."""
    from magical.learning import find_algorithm, read_config
    from magical.learning.config import options

    kind = find_algorithm(args.algorithm).config
    fields = options(kind)
    given = {
        option.name: tuple(value) if option.several else value
        for option in fields
        if (value := getattr(args, _dest(option.name), None)) is not None
    }
    if args.resume and args.preset is None:
        recorded = read_config(args.out, given)
        if recorded.algorithm != args.algorithm:
            raise UsageError(
                f"{args.out}: expected a run of {args.algorithm}, found one of {recorded.algorithm}"
            )
        return recorded.replace(**given)
    if missing := [o for o in fields if o.required and o.name not in given]:
        flags = ", ".join("--task" if o.name == "tasks" else o.flag for o in missing)
        raise UsageError(f"magical train {args.algorithm}: expected {flags}, found none")
    return kind.preset(args.preset or "paper", algorithm=args.algorithm, **given)
