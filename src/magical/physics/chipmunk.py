"""Chipmunk's C functions and structs below pymunk, by their addresses, for compiled code.

Their names, signatures and layout are private to pymunk and may change between releases, so
importing this module checks them once. pymunk's public functions step at the same motions, but take
a third longer, and hold the interpreter's lock between substeps.
"""

import math
from collections.abc import Callable, Sequence
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
NO_TRANSFORM = (1.0, 0.0, 0.0, 1.0, 0.0, 0.0)
ALL = 0xFFFFFFFF  # collision categories
Part = Any  # of a world: a pointer to Chipmunk's struct
Polygon = Sequence[tuple[float, float]]
Outline = tuple[Polygon | None, float]  # a polygon, or None for a circle; its radius


def address(part: Part) -> int:
    """The address of a space, a body or a constraint."""
    return int(ffi.cast("intptr_t", part))


def move(body: Part, values: Sequence[float]) -> None:
    """Set a body's x, y, angle and their velocities."""
    lib.cpBodySetPosition(body, tuple(values[:2]))
    lib.cpBodySetAngle(body, values[2])
    lib.cpBodySetVelocity(body, tuple(values[3:5]))
    lib.cpBodySetAngularVelocity(body, values[5])


def to_world(body: Part, point: tuple[float, float]) -> tuple[float, float]:
    """A point in a body's frame, in the world's."""
    found = lib.cpBodyLocalToWorld(body, point)
    return found.x, found.y


class World:
    """A Chipmunk space with what is added to it.

    An episode has some sixty parts. pymunk makes a Python object of each, with references to others
    and a function that frees it, which took most of the time of a reset.

    Attributes:
        space, static: the space and its static body.
    """

    def __init__(self, iterations: int, collision_slop: float) -> None:
        self._parts: list[tuple[Any, Part]] = []  # with the functions that free them
        self.space = ffi.gc(lib.cpSpaceNew(), _free(self._parts))
        lib.cpSpaceSetIterations(self.space, iterations)
        lib.cpSpaceSetCollisionSlop(self.space, collision_slop)
        self.static = self._add_body(lib.cpBodyNewStatic())

    def body(self, mass: float, moment: float, pose: tuple[float, float, float]) -> Part:
        """Add a body."""
        return self._add_body(lib.cpBodyNew(mass, moment), pose)

    def kinematic(self, pose: tuple[float, float, float]) -> Part:
        """Add a body that moves at given velocities."""
        return self._add_body(lib.cpBodyNewKinematic(), pose)

    def _add_body(self, body: Part, pose: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Part:
        self._parts.append((lib.cpBodyFree, body))
        lib.cpBodySetPosition(body, pose[:2])
        lib.cpBodySetAngle(body, pose[2])
        lib.cpSpaceAddBody(self.space, body)
        return body

    def shape(
        self, body: Part, outline: Polygon | None, radius: float, friction: float, group: int
    ) -> None:
        """Add a polygon with rounded corners, or a circle; those of one group do not collide."""
        if outline is None:
            shape = lib.cpCircleShapeNew(body, radius, (0.0, 0.0))
        else:
            shape = lib.cpPolyShapeNew(body, len(outline), outline, NO_TRANSFORM, radius)
        self._add_shape(shape, friction, group)

    def wall(self, start: Any, end: Any, radius: float, friction: float) -> None:
        """Add a segment that does not move."""
        self._add_shape(lib.cpSegmentShapeNew(self.static, start, end, radius), friction, 0)

    def _add_shape(self, shape: Part, friction: float, group: int) -> None:
        self._parts.append((lib.cpShapeFree, shape))
        lib.cpShapeSetFriction(shape, friction)
        lib.cpShapeSetFilter(shape, (group, ALL, ALL))
        lib.cpSpaceAddShape(self.space, shape)

    def joint(
        self,
        kind: str,
        bodies: tuple[Part, Part],
        *arguments: Any,
        max_force: float = math.inf,
        max_bias: float = math.inf,
        error_bias: float | None = None,
    ) -> Part:
        """Add a constraint, by the name of Chipmunk's function that makes it.

        Args:
            kind: such as "PinJointNew".
            bodies: the two that it connects.
            arguments: further arguments of the function.
            max_force, max_bias, error_bias: as pymunk's attributes of these names.
        """
        joint = getattr(lib, f"cp{kind}")(*bodies, *arguments)
        self._parts.append((lib.cpConstraintFree, joint))
        lib.cpConstraintSetMaxForce(joint, max_force)
        lib.cpConstraintSetMaxBias(joint, max_bias)
        if error_bias is not None:
            lib.cpConstraintSetErrorBias(joint, error_bias)
        lib.cpSpaceAddConstraint(self.space, joint)
        return joint


def _free(parts: list[tuple[Any, Part]]) -> Callable[[Part], None]:
    def free(space: Part) -> None:
        lib.cpSpaceFree(space)
        for free_part, part in parts:
            free_part(part)

    return free


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
