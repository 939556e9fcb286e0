"""Train a policy with one of the algorithms, each of which has its own options.

A run is kept in a folder: configuration, versions, names and SHA-256 sums of the demonstrations,
metrics, a checkpoint.
"""

import argparse
import io
import shlex
from collections.abc import Mapping, Sequence
from contextlib import redirect_stderr, suppress
from dataclasses import MISSING
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypedDict, get_args, get_origin

from magical.commands._common import INTERRUPTED, UsageError, log, print_json, task_name

if TYPE_CHECKING:
    from magical_baselines.config import Config

HELP = "train a policy"

METAVARS = {int: "N", float: "X", str: "NAME"}
# Options of the command itself: their types, placeholders, meanings.
OWN: Mapping[str, tuple[Any, str, str]] = {
    "out": (Path, "RUN", "run folder, new or empty unless with --resume (required)"),
    "resume": (
        bool,
        "",
        "resume the run in the folder; its configuration need not be given again",
    ),
    "preset": (str, "", "preset for all options that are not given (default: paper)"),
    "stop_after": (int, "N", "save a checkpoint and stop after N more batches or updates"),
    "track": (tuple[str, ...], "", "also log the metrics to these trackers"),
    "json": (bool, "", "print a JSON object as the last line of standard output"),
}


def configure(parser: argparse.ArgumentParser) -> None:
    """Describe the command's arguments without importing an algorithm, and so PyTorch."""
    from magical_baselines import algorithm_names

    parser.add_argument(
        "algorithm",
        metavar="ALGORITHM",
        help=f"one of {', '.join(algorithm_names())}; or module:NAME",
    )
    parser.add_argument(
        "options",
        nargs=argparse.REMAINDER,
        metavar="...",
        help="the algorithm's options: see magical train ALGORITHM --help",
    )


def run(args: argparse.Namespace) -> int:
    """Train, or resume."""
    from magical.errors import InvalidConfigError
    from magical.report.figures import save_learning_curves
    from magical_baselines import find_algorithm, train

    kind = find_algorithm(args.algorithm).config
    given = parse(kind, args.algorithm, args.options)
    own = argparse.Namespace(**{name: given.pop(name, None) for name in OWN})
    if own.out is None:
        raise UsageError(f"magical train {args.algorithm}: expected --out, found none")

    def plot_at_evaluations(step: int, metrics: Mapping[str, float | str]) -> None:
        if "evaluation_score" in metrics:
            save_learning_curves(own.out)

    track = own.track or ()
    try:
        config = _config(kind, args.algorithm, own, given)
        result = train(
            config,
            own.out,
            resume=bool(own.resume),
            stop_after=own.stop_after,
            progress=True,
            callback=plot_at_evaluations,
            track=track,
        )
    except InvalidConfigError as error:  # wrong arguments, not a failure
        raise UsageError(str(error)) from error
    save_learning_curves(own.out)
    print_json(own, result.summary())
    folder, imports = shlex.quote(str(result.folder)), _imports(config)
    if result.finished:
        log(f"{result.folder}: finished; to evaluate: magical evaluate {folder}{imports}")
        return 0
    tracks = f" --track {shlex.join(track)}" if track else ""
    demos = given.get("demos") if own.resume else None  # moved since the run began
    moved = f" --demos {shlex.quote(demos)}" if demos else ""
    again = f"magical train {args.algorithm} --out {folder} --resume{moved}{tracks}{imports}"
    log(f"{result.folder}: stopped at step {result.step}; to continue: {again}")
    return INTERRUPTED if result.interrupted else 0


def parse(kind: type["Config"], algorithm: str, words: Sequence[str]) -> dict[str, Any]:
    """The options among words of the command line: those that are given, by name.

    Raises:
        PluginError: an option of the configuration has the name of one of the command.
        UsageError: an unknown option, or a value of another type or not among the choices.
        SystemExit: after printing the help that was asked for.
    """
    import tyro

    from magical.errors import PluginError
    from magical_baselines.config import options, type_hints

    fields = {name: _own_option(kind, *parts, name=name) for name, parts in OWN.items()}
    for field in options(kind):
        if field.name in fields:
            raise PluginError(
                f"{kind.__name__}.{field.name}: `magical train` has an option of this name; give "
                "it another"
            )
        fields[field.name] = _option(kind, field, type_hints(kind)[field.name])
    make_type: Any = TypedDict  # from a dict, which type checkers do not follow
    table: Any = make_type("Options", fields, total=False)  # what is not given is left out
    printed = io.StringIO()
    try:
        with redirect_stderr(printed):
            given: dict[str, Any] = tyro.cli(
                table,
                args=words,
                prog=f"magical train {algorithm}",
                description=(kind.__doc__ or "").splitlines()[0],
            )
    except SystemExit as stop:
        if stop.code == 0:
            raise
        raise UsageError(
            f"{_in_one_line(printed.getvalue())}; see magical train {algorithm} --help"
        ) from stop
    if "tasks" in given:
        given["tasks"] = tuple(map(task_name, given["tasks"]))
    return given


def _own_option(kind: type["Config"], hint: Any, metavar: str, text: str, *, name: str) -> Any:
    from magical_baselines.run import TRACKERS

    if name == "track":
        hint = tuple[Literal[TRACKERS], ...]  # type: ignore[valid-type]
    if name == "preset":
        hint = Literal[tuple(kind.presets)]
    return _argument(name, hint, metavar, text)


def _option(kind: type["Config"], field: Any, hint: Any) -> Any:
    """A field of a configuration as tyro's argument."""
    text, metavar, group = (field.metadata[key] for key in ("help", "metavar", "plugins"))
    if group:
        from magical.plugins import plugins

        known = kind.observations if field.name == "observation" else sorted(plugins(group))
        metavar, text = f"{{{','.join(known)}}}", f"{text}; or module:NAME"
    if field.default not in (MISSING, None, "", ()):
        default = field.default
        shown = " ".join(default) if isinstance(default, tuple) else default
        text = f"{text} (paper: {shown})"
    return _argument(field.name, hint, metavar, text)


def _argument(name: str, hint: Any, metavar: str, text: str) -> Any:
    import tyro

    plain = get_args(hint)[0] if get_origin(hint) is Annotated else hint
    if not metavar and get_origin(plain) is not tuple:
        first = next(iter(get_args(plain)), plain)  # of `int | None`
        metavar = METAVARS.get(get_args(first)[0] if get_origin(first) is Annotated else first, "")
    flag = "task" if name == "tasks" else name
    return Annotated[
        hint,
        tyro.conf.arg(
            name=flag,
            aliases=("--tasks",) if name == "tasks" else None,
            help=text,
            metavar=metavar or None,
            help_behavior_hint="",
        ),
    ]


def _in_one_line(box: str) -> str:
    """The message of an error of tyro, without its frame, its title and its hints."""
    lines = [line.strip("│ ") for line in box.splitlines() if line.startswith("│")]
    rule = next((k for k, line in enumerate(lines) if line.startswith("─")), len(lines))
    return " ".join(lines[:rule])


def _config(
    kind: type["Config"], algorithm: str, own: argparse.Namespace, given: Mapping[str, Any]
) -> "Config":
    """The preset's or the resumed run's configuration, with the given options replaced."""
    from magical_baselines import read_config
    from magical_baselines.config import options

    if own.resume and own.preset is None:
        recorded = read_config(own.out, given)
        if recorded.algorithm != algorithm:
            raise UsageError(
                f"{own.out}: expected a run of {algorithm}, found one of {recorded.algorithm}"
            )
        return recorded.replace(**given)
    missing = [o.name for o in options(kind) if o.default is MISSING and o.name not in given]
    if missing:
        flags = ", ".join("--task" if name == "tasks" else f"--{name}" for name in missing)
        raise UsageError(f"magical train {algorithm}: expected {flags}, found none")
    return kind.preset(own.preset or "paper", algorithm=algorithm, **given)


def _imports(config: "Config") -> str:
    """`--import` for each module that the configuration names, which new processes need."""
    from magical.errors import InvalidTaskError
    from magical.tasks import get_task
    from magical.tasks.registry import defining_modules
    from magical_baselines.config import modules_of

    modules = dict.fromkeys(modules_of(config))
    with suppress(InvalidTaskError):  # no module can be named, but the run has been trained
        modules |= dict.fromkeys(defining_modules([get_task(name) for name in config.tasks]))
    return "".join(f" --import {shlex.quote(module)}" for module in modules)
