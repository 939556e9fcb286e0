"""A world of Chipmunk's, made by its C functions instead of pymunk's objects.

An episode has some sixty bodies, shapes and joints. pymunk makes a Python object of each, with
references to others and a function that frees it, which took most of the time of a reset.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any

from pymunk._chipmunk_cffi import ffi, lib

NO_TRANSFORM = (1.0, 0.0, 0.0, 1.0, 0.0, 0.0)
ALL = 0xFFFFFFFF  # collision categories
Part = Any  # of a world: a pointer to Chipmunk's struct
Polygon = Sequence[tuple[float, float]]
Outline = tuple[Polygon | None, float]  # a polygon, or None for a circle; its radius


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
    """A space with what is added to it, and its `static` body; parts are C pointers."""

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
        """Add a joint of two bodies, by the name of the C function, less `cp`, that makes it."""
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
