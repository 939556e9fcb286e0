"""Where a recording comes from."""

import platform
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any

import magical


def provenance() -> dict[str, Any]:
    """When and with which versions something was recorded, as plain data."""
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
