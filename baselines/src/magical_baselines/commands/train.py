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
from magical.errors import InvalidConfigError
from magical.plugins import plugins

if TYPE_CHECKING:
    from magical_baselines.config import Config, Field

HELP = "train a policy"

METAVARS = {int: "N", float: "X", str: "NAME"}
OWN = ("out", "resume", "preset", "stop_after", "track", "json")  # options of the command itself


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
    from magical.report.figures import save_learning_curves
    from magical_baselines import find_algorithm, train

    kind = find_algorithm(args.algorithm).config
    given = parse(kind, args.algorithm, args.options)
    own = argparse.Namespace(**{name: given.pop(name, None) for name in OWN})
    if own.out is None:
        raise UsageError(f"magical train {args.algorithm}: expected --out, found none")
    track = own.track or ()

    def plot_at_evaluations(step: int, metrics: Mapping[str, float | str]) -> None:
        if "evaluation_score" in metrics:
            save_learning_curves(own.out)

    try:
        config = _config(kind, args.algorithm, own, given)
    except InvalidConfigError as error:  # wrong arguments, not a failure
        raise UsageError(str(error)) from error
    result = train(
        config,
        own.out,
        resume=bool(own.resume),
        stop_after=own.stop_after,
        progress=True,
        callback=plot_at_evaluations,
        track=track,
    )
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
        UsageError: an unknown option, or a value of another type or not among the choices.
        SystemExit: after printing the help that was asked for.
    """
    import tyro

    from magical_baselines.config import options
    from magical_baselines.run import TRACKERS

    trackers: Any = tuple[Literal[TRACKERS], ...]  # type: ignore[valid-type]
    presets: Any = Literal[tuple(kind.presets)]
    own = (
        _argument("out", Path, "run folder, new or empty unless with --resume", "RUN"),
        _argument("resume", bool, "resume the run in the folder, with its configuration"),
        _argument("preset", presets, "preset for all options that are not given (default: paper)"),
        _argument("stop_after", int, "stop with a checkpoint after N more batches or updates"),
        _argument("track", trackers, "also log the metrics to these trackers"),
        _argument("json", bool, "print a JSON object as the last line of standard output"),
    )
    fields = dict(zip(OWN, own, strict=True))
    for field in options(kind):
        fields[field.name] = _option(kind, field)
    make_type: Any = TypedDict  # from a dict, which type checkers do not follow
    table: Any = make_type("Options", fields, total=False)  # what is not given is left out
    for flag in ("--task", "--tasks", "--track", "--variants"):  # tyro takes the last ones' values
        if sum(word.partition("=")[0] == flag for word in words) > 1:
            raise UsageError(f"{flag}: given more than once; put all values after one")
    summary, printed = (kind.__doc__ or "").splitlines()[0], io.StringIO()
    try:
        with redirect_stderr(printed):
            name = f"magical train {algorithm}"
            given: dict[str, Any] = tyro.cli(table, args=words, prog=name, description=summary)
    except SystemExit as stop:
        if stop.code == 0:
            raise
        raise UsageError(f"{_message(printed.getvalue())}; see {name} --help") from stop
    if "tasks" in given:
        given["tasks"] = tuple(map(task_name, given["tasks"]))
    return given


def _message(printed: str) -> str:
    """The message of an error that tyro prints below a title and above hints, all framed."""
    lines = [line.strip("│╭╮╰╯ ") for line in printed.splitlines()]
    rules = [k for k, line in enumerate(lines) if line[:1] == "─" or set(line) == {"-"}]
    first, following = (*rules, len(lines), len(lines))[:2]  # around the message
    return " ".join(lines[first + 1 : following])


def _option(kind: type["Config"], field: "Field") -> Any:
    """A field of a configuration as an argument."""
    from magical_baselines.config import type_hints

    text, metavar, group = (field.metadata[key] for key in ("help", "metavar", "plugins"))
    if group:
        names = field.metadata["known"] + tuple(sorted(plugins(group)))
        known = kind.observations if field.name == "observation" else names
        metavar, text = f"{{{','.join(known)}}}", f"{text}; or module:NAME"
    if field.default not in (MISSING, None, "", ()):
        several = isinstance(field.default, tuple)
        text += f" (paper: {' '.join(field.default) if several else field.default})"
    return _argument(field.name, type_hints(kind)[field.name], text, metavar)


def _argument(name: str, hint: Any, text: str, metavar: str = "") -> Any:
    """A type with tyro's description of the argument."""
    import tyro

    plain = hint
    while get_origin(plain) not in (None, tuple, Literal):  # of `Annotated` or `int | None`
        plain = get_args(plain)[0]
    tasks = name == "tasks"
    described = tyro.conf.arg(
        name="task" if tasks else name,
        aliases=("--tasks",) if tasks else None,
        help=text,
        metavar=metavar or METAVARS.get(plain),
        help_behavior_hint="",
    )
    return Annotated[hint, described]


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
