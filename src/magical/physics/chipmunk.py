"""Chipmunk below pymunk: its C functions and its bodies' memory, for compiled code.

Through pymunk's properties, ten substeps and one read of all bodies take a third longer. The names
and the layout used here are private and may change between releases, so importing this module
checks that pymunk's version is in the tested range, and `c_functions` checks each name and the
layout.
"""

import re
import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np
import pymunk

from magical.errors import DependencyVersionError

TESTED_VERSIONS = ((7, 3), (7, 4))  # at least the first, below the second; as in pyproject.toml
# The C functions that compiled code calls.
SIGNATURES = {
    "cpSpaceStep": "void(*)(struct cpSpace *, double)",
    "cpBodySetAngle": "void(*)(struct cpBody *, double)",
    "cpSimpleMotorSetRate": "void(*)(struct cpConstraint *, double)",
}
# A body of mass 2 and moment 4 in memory, after two pointers: mass, moment and their inverses,
# centre of gravity, position (5, 6), velocity (7, 8), force, angle 9, angular velocity 10.
LAYOUT = [2.0, 0.5, 4.0, 0.25, 0.0, 0.0, 5.0, 6.0, 7.0, 8.0, 0.0, 0.0, 9.0, 10.0]
POINTERS = 2  # of 8 bytes, like the numbers
POSITION, VELOCITY, ANGLE, SPIN = (POINTERS + LAYOUT.index(n) for n in (5.0, 7.0, 9.0, 10.0))


def check_version(version: str) -> None:
    """Raise `DependencyVersionError` for a version of pymunk outside `TESTED_VERSIONS`."""
    low, high = (".".join(map(str, bound)) for bound in TESTED_VERSIONS)
    found = tuple(map(int, re.findall(r"\d+", version)[:2]))
    if not TESTED_VERSIONS[0] <= found < TESTED_VERSIONS[1]:
        raise DependencyVersionError(
            f"expected pymunk >= {low} and < {high}, which this package was tested with, found "
            f"{version}; pip install 'pymunk>={low},<{high}'"
        )


check_version(pymunk.version)


def address(thing: Any) -> int:
    """The address of Chipmunk's struct for a `Space`, `Body` or `SimpleMotor`."""
    from pymunk._chipmunk_cffi import ffi

    private = {pymunk.Space: "_space", pymunk.Body: "_body", pymunk.SimpleMotor: "_constraint"}
    return int(ffi.cast("intptr_t", getattr(thing, private[type(thing)])))


def c_functions() -> Mapping[str, int] | None:
    """The addresses of the functions in `SIGNATURES`, or None, with a warning, if pymunk differs.

    It differs if it lacks one of them, if one has other arguments, or if a body has another layout
    in memory.
    """
    try:
        from pymunk._chipmunk_cffi import ffi, lib

        functions = {name: ffi.addressof(lib, name) for name in SIGNATURES}
        found = {name: ffi.typeof(function).cname for name, function in functions.items()}
        if found == SIGNATURES and _has_known_layout(ffi):
            return {name: int(ffi.cast("intptr_t", f)) for name, f in functions.items()}
    except (ImportError, AttributeError):
        pass
    warnings.warn(
        f"pymunk {pymunk.version}: expected the C functions and the layout of bodies of pymunk "
        "7.3.1, found others; the physics is simulated without compiled code: the same motions, "
        "but slower",
        RuntimeWarning,
        stacklevel=4,
    )
    return None


def _has_known_layout(ffi: Any) -> bool:
    """Whether a body's memory holds what `substeps` reads and writes there."""
    body = pymunk.Body(2.0, 4.0)
    body.position, body.velocity = (5.0, 6.0), (7.0, 8.0)
    body.angle, body.angular_velocity = 9.0, 10.0
    buffer = ffi.buffer(ffi.cast("char *", body._body), 8 * (POINTERS + len(LAYOUT)))
    memory = np.frombuffer(buffer)
    if memory[POINTERS:].tolist() != LAYOUT:
        return False
    memory[VELOCITY] = 11.0
    return bool(body.velocity == (11.0, 8.0))
