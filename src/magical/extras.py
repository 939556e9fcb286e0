"""The optional libraries, and the extras of the package that bring them."""

import importlib
import importlib.util
import re
from typing import Any

from magical.errors import MissingDependencyError

# Top-level modules by extra.
EXTRAS = {
    "report": ("jinja2", "matplotlib"),
    "human": ("pooch",),
    "video": ("av",),
    "minari": ("minari", "h5py"),
    "hub": ("huggingface_hub",),
}


def require(extra: str) -> None:
    """Raise `MissingDependencyError` unless all libraries of an extra are installed.

    Call it before work whose result needs them.
    """
    for module in EXTRAS[extra]:
        if not _is_installed(module):
            raise missing(module)


def missing(module: str) -> MissingDependencyError:
    """The error for a library that is not installed, with the command that installs its extra.

    Raises:
        LookupError: the module belongs to no extra.
    """
    top = module.partition(".")[0]
    extra = next((name for name, modules in EXTRAS.items() if top in modules), None)
    if extra is None:
        raise LookupError(module)
    return MissingDependencyError(
        f"this needs {top}, which is not installed: pip install {_requirements(extra)} "
        f"(the extra {extra!r} of magical-benchmark)"
    )


def library(name: str, user: str) -> Any:
    """Import a library that is in no extra of this package.

    Args:
        name: the name of the module and of its distribution.
        user: what needs it, for the message.

    Raises:
        MissingDependencyError: it is not installed.
    """
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        raise MissingDependencyError(
            f"{user}: this needs {error.name}, which is not installed: pip install {name}"
        ) from error


def _requirements(extra: str) -> str:
    """The extra's requirements, quoted for a shell, from the installed package's metadata."""
    from importlib.metadata import requires  # tens of milliseconds, only for a message

    wanted = re.compile(rf"(?P<need>[^;]+);.*extra == ['\"]{extra}['\"]")
    found = map(wanted.match, requires("magical-benchmark") or [])
    return " ".join(f'"{match["need"].strip()}"' for match in found if match)


def _is_installed(module: str) -> bool:
    try:
        return importlib.util.find_spec(module) is not None
    except ValueError:  # imported, without a `__spec__`: a stand-in
        return False
