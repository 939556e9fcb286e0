"""Reading plans from TOML files (docs/experiments.md). Messages name the file and the key."""

import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from magical.envs.episode import checked_nudge
from magical.errors import InvalidConfigError, MagicalError, MissingDependencyError, PlanError
from magical.evaluation.variants import full_variant
from magical.experiments.plan import Evaluation, Method, Plan, planned_runs
from magical.experts.noise import check_share
from magical.learning import find_algorithm
from magical.learning.config import Option, options
from magical.messages import quoted
from magical.tasks import TASKS, get_task

HORIZONS = ("appendix", "published")
OF_THE_PLAN = ("tasks", "seed", "demos")  # settings that a method cannot change
MAX_NAME = 100  # characters of a method's name
MAX_NUMBER = 2**31 - 1
MAX_RUNS = 100_000

Reader = Callable[[Any, str], Any]  # of a key's value; the second argument names the key


def read_plan(path: Path, demos: str | None = None) -> Plan:
    """Read a plan from a TOML file.

    Args:
        path: the file.
        demos: replaces the file's `demos`.

    Raises:
        PlanError: no TOML, unknown names, values of other types, settings that cannot be combined,
            or the same run twice.
        MissingDependencyError: PyTorch is not installed.
    """
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise PlanError(f"{path}: expected a plan in TOML, found none: {error}") from error
    try:
        plan = _plan(data if demos is None else {**data, "demos": demos})
        planned_runs(plan)
    except PlanError as error:
        raise PlanError(f"{path}: {error}") from error
    return plan


def _plan(data: Mapping[str, Any]) -> Plan:
    """A plan from the contents of its file."""
    _require_known(data, (*_PLAN, *_EVALUATION, "methods", "preset"), "")
    preset = _text(data.get("preset", "paper"), "preset")
    rows = _list(data.get("methods", []), "methods")
    methods = tuple(_method(row, f"methods[{number}]", preset) for number, row in enumerate(rows))
    _distinct([method.name for method in methods], "methods: name")
    evaluation = Evaluation(**_read(data, _EVALUATION))
    plan = Plan(
        **{"tasks": tuple(TASKS), **_read(data, _PLAN)}, methods=methods, evaluation=evaluation
    )
    if len(methods) * len(plan.tasks) * len(plan.seeds) > MAX_RUNS:
        raise PlanError(f"expected at most {MAX_RUNS} runs, found more")
    return plan


def _method(row: Any, key: str, preset: str) -> Method:
    row = _of_type(dict, row, key)
    _require_known(row, _METHOD, f"{key}.")
    for name in ("name", "algorithm"):
        if name not in row:
            raise PlanError(f"{key}: expected {name}, found {', '.join(row) or 'nothing'}")
    method = Method(**{"preset": preset, **_read(row, _METHOD, f"{key}.")})
    known = {option.name: option for option in options(find_algorithm(method.algorithm).config)}
    for name in OF_THE_PLAN:
        known.pop(name, None)
    _require_known(method.settings, known, f"{key}.settings.")
    settings = {
        name: _setting(value, known[name], f"{key}.settings.{name}")
        for name, value in method.settings.items()
    }
    return replace(method, settings=settings)


def _read(data: Mapping[str, Any], readers: Mapping[str, Reader], prefix: str = "") -> Any:
    """The values of the keys that are there."""
    return {
        name: reader(data[name], f"{prefix}{name}")
        for name, reader in readers.items()
        if name in data
    }


def _setting(value: Any, option: Option, key: str) -> Any:
    """A setting of the type that the configuration's field has."""
    if option.several:
        return tuple(_number_or_other(option.kind, item, key) for item in _list(value, key))
    return _number_or_other(option.kind, value, key)


def _number_or_other(kind: type, value: Any, key: str) -> Any:
    return float(value) if kind is float and type(value) is int else _of_type(kind, value, key)


def _of_type(kind: type, value: Any, key: str) -> Any:
    """A value of exactly a type: TOML tells 1, 1.0, true and "1" apart."""
    if type(value) is not kind:
        raise PlanError(f"{key}: expected {_TYPES[kind]}, found {quoted(value)}")
    return value


_TYPES = {
    bool: "true or false",
    int: "an integer",
    float: "a number",
    str: "a string",
    list: "a list",
    dict: "a table",
}


def _text(value: Any, key: str) -> Any:
    return _of_type(str, value, key)


def _boolean(value: Any, key: str) -> Any:
    return _of_type(bool, value, key)


def _list(value: Any, key: str) -> list[Any]:
    """A list that is not empty."""
    items: list[Any] = _of_type(list, value, key)
    if not items:
        raise PlanError(f"{key}: expected at least one, found none")
    return items


def _name(value: Any, key: str) -> str:
    name: str = _text(value, key)
    if not name.strip() or len(name) > MAX_NAME or not name.isprintable():
        raise PlanError(
            f"{key}: expected 1 to {MAX_NAME} printable characters, found {quoted(name)}"
        )
    return name


def _algorithm(value: Any, key: str) -> str:
    with _naming(key):
        return find_algorithm(_text(value, key)).name


def _tasks(value: Any, key: str) -> tuple[str, ...]:
    with _naming(key):
        names = [get_task(_text(name, key)).name for name in _list(value, key)]
    return _distinct(names, key)


def _variants(value: Any, key: str) -> tuple[str, ...]:
    with _naming(key):
        names = [full_variant(_text(name, key)) for name in _list(value, key)]
    return _distinct(names, key)


def _seeds(value: Any, key: str) -> tuple[int, ...]:
    return _distinct([_integer(seed, key, least=0) for seed in _list(value, key)], key)


def _integer(value: Any, key: str, least: int = 1) -> int:
    number: int = _of_type(int, value, key)
    if not least <= number <= MAX_NUMBER:
        raise PlanError(f"{key}: expected {least} to {MAX_NUMBER}, found {quoted(number)}")
    return number


def _horizon(value: Any, key: str) -> str | int:
    if type(value) is int:
        return _integer(value, key)
    if value not in HORIZONS:
        raise PlanError(
            f"{key}: expected a number of control steps, {' or '.join(HORIZONS)}, "
            f"found {quoted(value)}"
        )
    return str(value)


def _nudge(value: Any, key: str) -> float:
    try:
        return checked_nudge(value)
    except ValueError as error:
        raise PlanError(str(error)) from error  # which names the key


def _perturb(value: Any, key: str) -> float:
    share: float = _number_or_other(float, value, key)
    try:
        check_share("perturb", share)
    except InvalidConfigError as error:
        raise PlanError(str(error)) from error  # which names the key
    return share


def _min_score(value: Any, key: str) -> float:
    score: float = _number_or_other(float, value, key)
    if not 0.0 <= score <= 1.0:
        raise PlanError(f"{key}: expected a score from 0 to 1, found {quoted(value)}")
    return score


def _distinct(values: Sequence[Any], key: str) -> tuple[Any, ...]:
    for value in values:
        if values.count(value) > 1:
            raise PlanError(f"{key}: expected each once, found {quoted(value)} twice")
    return tuple(values)


def _require_known(
    data: Mapping[str, Any], known: Sequence[str] | Mapping[str, Any], prefix: str
) -> None:
    for name in data:
        if name not in known:
            raise PlanError(
                f"{prefix}{name[:MAX_NAME]}: unknown; expected some of: {', '.join(known)}"
            )


@contextmanager
def _naming(key: str) -> Iterator[None]:
    """Add the key to the message of an error."""
    try:
        yield
    except (PlanError, MissingDependencyError):
        raise
    except MagicalError as error:
        raise PlanError(f"{key}: {error}") from error


_PLAN: Mapping[str, Reader] = {
    "tasks": _tasks,
    "seeds": _seeds,
    "demos": _text,
    "add_expert": _boolean,
    "num_demos": _integer,
    "expert_demos": _integer,
    "perturb": _perturb,
    "min_score": _min_score,
    "threads": _integer,
}
_EVALUATION: Mapping[str, Reader] = {
    "rollouts": _integer,
    "variants": _variants,
    "horizon": _horizon,
    "nudge": _nudge,
}
_METHOD: Mapping[str, Reader] = {
    "name": _name,
    "algorithm": _algorithm,
    "preset": _text,
    "multi_task": _boolean,
    "settings": lambda value, key: _of_type(dict, value, key),
}
