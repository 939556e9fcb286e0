"""With what, and where, a result was made."""

from typing import Any

from magical.runs.folder import versions
from magical.runs.machine import machine, source_commit


def provenance() -> dict[str, Any]:
    """Versions, the commit of the package's source (`None` if unknown) and the machine."""
    return {"versions": versions(), "commit": source_commit(), "machine": machine()}
