"""Provenance of a recording: date, versions and platform."""

import platform
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any

import magical


def provenance() -> dict[str, Any]:
    """Date, versions and platform of a recording made now, as plain data."""
    libraries = ("numpy", "pymunk", "gymnasium")
    return {
        "recorded": datetime.now(UTC).isoformat(timespec="seconds"),
        "versions": {
            "magical": magical.__version__,
            "python": platform.python_version(),
            **{library: version(library) for library in libraries},
        },
        "platform": platform.platform(terse=True),
    }
