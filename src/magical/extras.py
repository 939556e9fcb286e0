"""The optional libraries, and the extras of the package that bring them."""

import importlib
from importlib.util import find_spec
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
    """Raise `MissingDependencyError` unless an extra is installed; call it before work."""
    for module in EXTRAS[extra]:
        if find_spec(module) is None:
            raise missing(module)


def missing(module: str) -> MissingDependencyError:
    """The error for a library that is not installed, with the command that installs its extra.

    Raises `LookupError` if the module is in no extra.
    """
    top = module.partition(".")[0]
    extras = {module: extra for extra, modules in EXTRAS.items() for module in modules}
    return MissingDependencyError(
        f'this needs {top}, which is not installed: pip install "magical-benchmark[{extras[top]}]"'
    )


def library(name: str, user: str) -> Any:
    """Import a library that is in no extra, for `user`, or raise `MissingDependencyError`."""
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        raise MissingDependencyError(
            f"{user}: this needs {error.name}, which is not installed: pip install {name}"
        ) from error
