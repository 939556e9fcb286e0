"""The versions, commit and machine that a result was made with."""

import platform
import subprocess
from contextlib import suppress
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

from magical import __file__ as PACKAGE
from magical import __version__
from magical.plugins import distributions
from magical.processes import available_cores

VERSIONED = ("torch", "numpy", "pymunk", "numba", "safetensors")  # what results may depend on
CPU_INFO = Path("/proc/cpuinfo")


def provenance() -> dict[str, Any]:
    """Versions, the commit of the package's source (`None` if unknown) and the machine."""
    return {"versions": versions(), "commit": source_commit(), "machine": machine()}


def versions() -> dict[str, str]:
    """Versions of what results may depend on: Python, this package, libraries, plug-ins."""
    found = {"magical": __version__, "python": platform.python_version()}
    for name in VERSIONED:
        with suppress(metadata.PackageNotFoundError):  # an extra that is not installed
            found[name] = metadata.version(name)
    return {**found, **distributions()}


def machine() -> dict[str, str]:
    """This machine: name, operating system, processor, the cores that this process may use."""
    return {
        "name": platform.node(),
        "platform": platform.platform(terse=True),
        "processor": _processor(),
        "cores": str(available_cores()),
    }


@cache
def source_commit() -> str | None:
    """The commit of the package's source at the first call, with `-dirty` after local changes.

    `None` unless the package is imported from a clone and git is installed.
    """
    initial = Path(PACKAGE)
    if _git(initial.parent, "ls-files", "--error-unmatch", initial.name) is None:
        return None
    return _git(initial.parent, "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*")


def _processor() -> str:
    """The processor's model, which `platform` does not know on Linux."""
    text = CPU_INFO.read_text(encoding="utf-8", errors="replace") if CPU_INFO.is_file() else ""
    models = (line.partition(":")[2] for line in text.splitlines() if line.startswith("model name"))
    return next(models, "").strip() or platform.processor() or platform.machine()


def _git(folder: Path, *arguments: str) -> str | None:
    """The output of a git command in a folder; `None` if it fails."""
    command = ["git", "-C", str(folder), *arguments]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    except OSError:  # git is not installed
        return None
    return done.stdout.strip() if done.returncode == 0 else None
