"""Chipmunk's C functions and structs below pymunk, by their addresses, for compiled code.

Their names, signatures and layout are private to pymunk and may change between releases, so
importing this module checks them once. pymunk's public functions step at the same motions, but take
a third longer, and hold the interpreter's lock between substeps.
"""

from typing import Any

import numpy as np
import pymunk
from pymunk._chipmunk_cffi import ffi, lib

from magical.errors import DependencyVersionError

# The C functions that compiled code calls.
SIGNATURES = {
    "cpSpaceStep": "void(*)(struct cpSpace *, double)",
    "cpBodySetAngle": "void(*)(struct cpBody *, double)",
    "cpSimpleMotorSetRate": "void(*)(struct cpConstraint *, double)",
    "cpConstraintSetMaxBias": "void(*)(struct cpConstraint *, double)",
}
# A body of mass 2 and moment 4 in memory, after two pointers: mass, moment and their inverses,
# centre of gravity, position (5, 6), velocity (7, 8), force, angle 9, angular velocity 10.
LAYOUT = [2.0, 0.5, 4.0, 0.25, 0.0, 0.0, 5.0, 6.0, 7.0, 8.0, 0.0, 0.0, 9.0, 10.0]
POINTERS = 2  # of 8 bytes, like the numbers
POSITION, VELOCITY, ANGLE, SPIN = (POINTERS + LAYOUT.index(n) for n in (5.0, 7.0, 9.0, 10.0))
_PRIVATE = {pymunk.Space: "_space", pymunk.Body: "_body"}  # others: "_constraint"


def address(thing: Any) -> int:
    """The address of Chipmunk's struct for a `Space`, a `Body` or a constraint."""
    return int(ffi.cast("intptr_t", getattr(thing, _PRIVATE.get(type(thing), "_constraint"))))


def c_functions() -> dict[str, int]:
    """The addresses of the functions in `SIGNATURES`.

    Raises:
        DependencyVersionError: pymunk lacks one of them, one has other arguments, or a body has
            another layout in memory.
    """
    body = pymunk.Body(2.0, 4.0)
    body.position, body.velocity = (5.0, 6.0), (7.0, 8.0)
    body.angle, body.angular_velocity = 9.0, 10.0
    size = 8 * (POINTERS + len(LAYOUT))
    memory = np.frombuffer(ffi.buffer(ffi.cast("char *", body._body), size))
    functions = {name: ffi.addressof(lib, name) for name in SIGNATURES if hasattr(lib, name)}
    found = {name: ffi.typeof(function).cname for name, function in functions.items()}
    if found == SIGNATURES and memory[POINTERS:].tolist() == LAYOUT:
        return {name: int(ffi.cast("intptr_t", f)) for name, f in functions.items()}
    raise DependencyVersionError(
        f"expected the C functions and bodies of pymunk 7.3, found others in pymunk "
        f"{pymunk.version}; pip install 'pymunk>=7.3,<7.4'"
    )


C_FUNCTIONS = c_functions()
