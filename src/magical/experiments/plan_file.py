"""Reading plans from TOML files (docs/experiments.md), those of this package by name."""

from dataclasses import replace
from importlib.resources import files
from pathlib import Path

from magical.errors import PlanError
from magical.experiments.plan import Plan, planned_runs
from magical.untrusted import read_toml

SUFFIX = ".toml"
PLANS = Path(str(files("magical"))) / "plans"


def find_plan(name: str) -> Path:
    """The file of one of this package's plans, such as `quick`, or the file at a path.

    Raises:
        PlanError: neither.
    """
    for path in (PLANS / f"{name}{SUFFIX}", Path(name)):
        if path.is_file():
            return path
    known = ", ".join(sorted(path.stem for path in PLANS.glob(f"*{SUFFIX}")))
    raise PlanError(f"{name}: expected a file with a plan in TOML, or one of {known}; found none")


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
    plan = read_toml(path, Plan, PlanError)
    try:
        plan = plan if demos is None else replace(plan, demos=demos)
        planned_runs(plan)
    except PlanError as error:
        raise PlanError(f"{path}: {error}") from error
    return plan
