"""The physics of one episode, with pymunk (docs/specification.md, sections 2 to 5).

This is the only room that imports pymunk. An episode's bodies, shapes and joints, some sixty, are
made by Chipmunk's C functions: pymunk's object for each, with references to others and a function
that frees it, took most of the time of a reset.
"""

import math
from collections.abc import Sequence
from functools import cache, partial
from typing import Any

import numpy as np
import pymunk
import pymunk.autogeometry
from numpy.typing import NDArray
from pymunk._chipmunk_cffi import ffi, lib

from magical.scene import (
    Block,
    Dynamics,
    Pose,
    Poses,
    Scene,
    Shape,
    block_outline,
    finger_polygons,
    rotate,
)
from magical.scene import constants as c

Part = Any  # a pointer to Chipmunk's struct of a body, a shape or a joint
Polygon = Sequence[tuple[float, float]]
Outline = tuple[Polygon, float]  # with its rounding radius; without points a circle

ORIGIN = (0.0, 0.0)
ROBOT_GROUP = 1  # collision group shared by all shapes of the robot
_ALL = 0xFFFFFFFF  # collision categories
_NO_TRANSFORM = (1.0, 0.0, 0.0, 1.0, 0.0, 0.0)
_ROW = np.zeros(1, np.int64)


class Simulation:
    """A scene under given dynamics, stepped at the control rate of 8 Hz.

    Bodies are added to the space in rendering order, walls first: the solver's result depends on
    the order (docs/specification.md, section 6).

    Attributes:
        robot: (8,) int64, and places: (5 + blocks, 2) int64: addresses for `substeps.step_rows`,
            valid as long as this object.
    """

    def __init__(self, scene: Scene, dynamics: Dynamics | None = None) -> None:
        from magical.physics import substeps  # imports numba: only when something is simulated

        self._kernels = substeps
        self.scene = scene
        self.dynamics = dynamics or Dynamics()
        self._parts: list[tuple[Any, Part]] = []  # with the functions that free them
        self._space = ffi.gc(lib.cpSpaceNew(), partial(_free, self._parts))
        lib.cpSpaceSetIterations(self._space, c.SOLVER_ITERATIONS)
        lib.cpSpaceSetCollisionSlop(self._space, c.COLLISION_SLOP)
        self._static = self._add_body(lib.cpBodyNewStatic(), Pose(0.0, 0.0, 0.0))
        far = c.WORKSPACE_HALF + c.WALL_DISTANCE
        corners = ((-far, far), (far, far), (far, -far), (-far, -far))
        for wall in zip(corners, corners[1:] + corners[:1], strict=True):
            self._add_shape(self._static, wall, c.WALL_RADIUS, c.WALL_FRICTION, 0)
        if scene.robot_first:
            robot, driven = self._add_robot()
        blocks = [
            self._add_block(block, group)
            for group, block in enumerate(scene.blocks, ROBOT_GROUP + 1)
        ]
        if not scene.robot_first:
            robot, driven = self._add_robot()
        self._bodies = [*robot, *blocks]
        self.robot = np.array([substeps.address(part) for part in (self._space, *driven)])
        turns = np.array([substeps.address(each) for each in self._bodies])
        positions = turns.copy()
        positions[3:5] = turns[0]  # eyes have no position of their own
        self.places = np.stack([positions, turns], axis=1)
        self._only_row = _ROW, self.robot[None], self.places[None]

    def step(self, action: Sequence[float] | NDArray[np.float64]) -> NDArray[np.float64]:
        """Advance by one control step of 1/8 s; returns what `read` returns.

        Args:
            action: drive, turn and grip, each from -1 to 1; not checked here.
        """
        out = np.empty((1, len(self._bodies), 6))
        self._kernels.step_rows(*self._only_row, np.array([action], np.float64), out)
        bodies: NDArray[np.float64] = out[0]
        return bodies

    def read(self) -> NDArray[np.float64]:
        """Pose and velocity of every body, a new array (5 + number of blocks, 6).

        In the rows of `Poses`: x, y, angle and their velocities, in units, radians and seconds. The
        eyes' positions are the robot's.
        """
        out = np.empty((len(self._bodies), 6))
        self._kernels.read_one(self.places, out)
        return out

    def poses(self) -> Poses:
        """The current pose of every body."""
        return Poses(self.read()[:, :3])

    def write(self, bodies: NDArray[np.float64]) -> None:
        """Move every body to a pose and give it a velocity: the inverse of `read`.

        Contacts from the previous step are dropped only if the bodies have moved apart.

        Args:
            bodies: (5 + number of blocks, 6), as `read` returns it; the eyes' positions have
                no effect. The solver needs finite numbers up to `MAX_COORDINATE`.
        """
        for body, row in zip(self._bodies, bodies.tolist(), strict=True):
            lib.cpBodySetPosition(body, tuple(row[:2]))
            lib.cpBodySetAngle(body, row[2])
            lib.cpBodySetVelocity(body, tuple(row[3:5]))
            lib.cpBodySetAngularVelocity(body, row[5])

    def _add_body(self, body: Part, pose: Pose) -> Part:
        self._parts.append((lib.cpBodyFree, body))
        lib.cpBodySetPosition(body, pose[:2])
        lib.cpBodySetAngle(body, pose[2])
        lib.cpSpaceAddBody(self._space, body)
        return body

    def _add_shape(
        self, body: Part, outline: Polygon, radius: float, friction: float, group: int
    ) -> None:
        """Add a polygon, a segment or a circle (0 points); those of one group do not collide."""
        if len(outline) > 2:
            shape = lib.cpPolyShapeNew(body, len(outline), outline, _NO_TRANSFORM, radius)
        elif outline:
            shape = lib.cpSegmentShapeNew(body, *outline, radius)
        else:
            shape = lib.cpCircleShapeNew(body, radius, ORIGIN)
        self._parts.append((lib.cpShapeFree, shape))
        lib.cpShapeSetFriction(shape, friction)
        lib.cpShapeSetFilter(shape, (group, _ALL, _ALL))
        lib.cpSpaceAddShape(self._space, shape)

    def _add_joint(
        self,
        joint: Part,
        max_force: float = math.inf,
        max_bias: float = math.inf,
        error_bias: float | None = None,
    ) -> Part:
        self._parts.append((lib.cpConstraintFree, joint))
        lib.cpConstraintSetMaxForce(joint, max_force)
        lib.cpConstraintSetMaxBias(joint, max_bias)
        if error_bias is not None:
            lib.cpConstraintSetErrorBias(joint, error_bias)
        lib.cpSpaceAddConstraint(self._space, joint)
        return joint

    def _add_block(self, block: Block, group: int) -> Part:
        """Add one block with its surface drag; `group` is a collision group for it alone."""
        body = self._add_body(lib.cpBodyNew(c.BLOCK_MASS, _block_moment(block.shape)), block.pose)
        for outline, radius in block_shapes(block.shape):
            self._add_shape(body, outline, radius, c.BLOCK_FRICTION, group)
        pivot = lib.cpPivotJointNew2(self._static, body, ORIGIN, ORIGIN)
        self._add_joint(pivot, self.dynamics.block_pivot_max_force, max_bias=0.0)
        gear = lib.cpGearJointNew(self._static, body, 0.0, 1.0)
        self._add_joint(gear, self.dynamics.block_gear_max_force, max_bias=0.0)
        return body

    def _add_robot(self) -> tuple[list[Part], list[Part]]:
        """Add the robot.

        Returns:
            Its body, both fingers, both eyes; and what `substeps.step_rows` needs: its body, its
            control body, the gear joint between them, both fingers, their motors.
        """
        pose, dynamics = self.scene.robot, self.dynamics
        moment = pymunk.moment_for_circle(c.ROBOT_MASS, 0, c.ROBOT_RADIUS)
        body = self._add_body(lib.cpBodyNew(c.ROBOT_MASS, moment), pose)
        control = self._add_body(lib.cpBodyNewKinematic(), pose)
        pivot = lib.cpPivotJointNew2(control, body, ORIGIN, ORIGIN)
        self._add_joint(pivot, dynamics.body_pivot_max_force, max_bias=0.0)
        gear = lib.cpGearJointNew(control, body, 0.0, 1.0)
        self._add_joint(gear, dynamics.body_gear_max_force, c.TURN_MAX_BIAS, error_bias=0.0)
        moment = pymunk.moment_for_circle(c.EYE_MASS, 0, c.ROBOT_RADIUS)
        eyes = [self._add_body(lib.cpBodyNew(c.EYE_MASS, moment), pose) for _ in c.SIDES]
        for eye in eyes:
            # The spring's max_force stays unlimited: a limit changes how the robot turns.
            spring = 0.0, c.EYE_SPRING_STIFFNESS, c.EYE_SPRING_DAMPING
            self._add_joint(lib.cpDampedRotarySpringNew(body, eye, *spring))
        fingers, motors = [], []
        for side in c.SIDES:
            root = (side * c.FINGER_ROOT_X, c.FINGER_ROOT_Y)
            start = finger_position(body, root, pose)
            place = Pose(*start, pose.angle - side * c.FINGER_OPEN)
            finger = self._add_body(lib.cpBodyNew(c.FINGER_MASS, _finger_moment(side)), place)
            # A pin joint of zero length, as published; a pivot joint grips visibly differently.
            self._add_joint(lib.cpPinJointNew(body, finger, root, ORIGIN), error_bias=0.0)
            limits = (0.0, c.FINGER_OPEN) if side < 0 else (-c.FINGER_OPEN, 0.0)
            self._add_joint(lib.cpRotaryLimitJointNew(body, finger, *limits), error_bias=0.0)
            motor = lib.cpSimpleMotorNew(body, finger, 0.0)
            motors.append(self._add_joint(motor, dynamics.finger_motor_max_force, max_bias=0.0))
            fingers.append(finger)
        self._add_shape(body, (), c.ROBOT_RADIUS, c.ROBOT_FRICTION, ROBOT_GROUP)
        for finger, side in zip(fingers, c.SIDES, strict=True):
            for polygon in finger_polygons(side):
                self._add_shape(finger, polygon, 0.0, c.FINGER_FRICTION, ROBOT_GROUP)
        return [body, *fingers, *eyes], [body, control, gear, *fingers, *motors]


def _free(parts: list[tuple[Any, Part]], space: Part) -> None:
    lib.cpSpaceFree(space)
    for free_part, part in parts:
        free_part(part)


@cache
def _block_moment(shape: Shape) -> float:
    if shape == Shape.CIRCLE:
        return pymunk.moment_for_circle(c.BLOCK_MASS, 0, c.BLOCK_SIZE)
    outline = block_outline(shape)
    hull = outline[::2] if shape == Shape.STAR else outline  # for a star, the outer vertices
    return pymunk.moment_for_poly(c.BLOCK_MASS, hull)


@cache
def block_shapes(shape: Shape) -> list[Outline]:
    """The convex shapes of a block, in its body's frame."""
    # Cached for more than speed: pymunk leaks some 2 kB in every decomposition.
    if shape == Shape.STAR:
        outline = list(block_outline(shape))
        parts = pymunk.autogeometry.convex_decomposition(outline + outline[:1], 0)
        return [(part, 0.0) for part in parts]
    radius = {Shape.CIRCLE: c.BLOCK_SIZE, Shape.SQUARE: c.SQUARE_MARGIN}.get(shape, 0.0)
    return [(block_outline(shape), radius)]


@cache
def _finger_moment(side: int) -> float:
    upper, forearm = finger_polygons(side)
    # The polygon through both rectangles' vertices in this order crosses itself; the published
    # moment (0.005006 left, 0.004983 right) is this polygon's.
    return pymunk.moment_for_poly(c.FINGER_MASS, upper + forearm)


# The largest power of two that `finger_position` tries: enough for a robot whose coordinates are 0
# or above 2**-16 units. For others the direction is rounded to about one part in 4096, which
# matters less than a longer pin.
_MAX_POWER = 12


def finger_position(body: Part, root: tuple[float, float], pose: Pose) -> tuple[float, float]:
    """The initial position of a finger: its root in the workspace, displaced by some 1e-15 units.

    `body` is the robot's, already at `pose`, `root` where the finger is attached, in its frame.

    A pin joint pulls along the line between its anchors. A finger hangs on a pin of zero length, so
    initially this line is a rounding error, normalised. Chipmunk computes it (cpPinJoint.c) as

        (finger + 0) - (robot + root)

    with the root already rotated, which is exactly (0, 0) for a finger placed at robot + root: the
    pin has no direction and does not act in the first substep. pymunk 5.6.0, used by the published
    environments, was compiled with -ffast-math and adds the same terms in the order

        ((finger - robot) + 0) - root

    which is the rounding error of robot + root, some 1e-17 units. Its direction decides how the
    robot starts to move; the first step differs by some 1e-4 units. Here the finger is displaced by
    a power of two times that error, which gives the first expression the published direction to the
    last bit. The smallest power that is a whole number of spacings of floating-point numbers at the
    finger is used, because the effect of the pin's length, which the published one lacks, grows
    with it. A pin joint made afterwards takes the displacement as its length and is at rest.
    """
    # As Chipmunk computes it, which is what the pin subtracts.
    anchor = lib.cpBodyLocalToWorld(body, root)
    root_x, root_y = rotate(root, pose.angle)
    error_x = ((pose.x + root_x) - pose.x) - root_x
    error_y = ((pose.y + root_y) - pose.y) - root_y
    for power in range(_MAX_POWER + 1):
        step_x, step_y = 2**power * error_x, 2**power * error_y
        x, y = anchor.x + step_x, anchor.y + step_y
        if x - anchor.x == step_x and y - anchor.y == step_y:
            break
    return x, y
