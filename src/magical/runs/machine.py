"""The versions, commit and machine that a result was made with."""

import platform
import subprocess
from functools import cache
from pathlib import Path
from typing import Any

from magical import __file__ as PACKAGE
from magical.processes import available_cores
from magical.runs.folder import versions

_CPU_INFO = Path("/proc/cpuinfo")
_TIMEOUT = 10.0  # seconds for git


def provenance() -> dict[str, Any]:
    """Versions, the commit of the package's source (`None` if unknown) and the machine."""
    return {"versions": versions(), "commit": source_commit(), "machine": machine()}


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
    if _CPU_INFO.is_file():
        for line in _CPU_INFO.read_text(encoding="utf-8", errors="replace").splitlines():
            name, _, value = line.partition(":")
            if name.strip() == "model name":
                return value.strip()
    return platform.processor() or platform.machine()


def _git(folder: Path, *arguments: str) -> str | None:
    """The output of a git command in a folder; `None` if it fails."""
    command = ["git", "-C", str(folder), *arguments]
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, check=False, timeout=_TIMEOUT
        )
    except (OSError, subprocess.TimeoutExpired):  # git is not installed, or does not end
        return None
    return done.stdout.strip() if done.returncode == 0 else None
