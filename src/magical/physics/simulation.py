"""The physics of one episode, with pymunk (docs/specification.md, sections 2 to 5)."""

from collections.abc import Sequence
from functools import cache

import numpy as np
import pymunk
import pymunk.autogeometry
from numpy.typing import NDArray

from magical.errors import InvalidSceneError
from magical.physics.chipmunk import address
from magical.scene import constants as c
from magical.scene.geometry import Point, block_outline, finger_polygons, rotate
from magical.scene.poses import Poses
from magical.scene.scene import Block, Dynamics, Pose, Scene
from magical.scene.vocabulary import Shape

ROBOT_GROUP = 1  # collision group shared by all shapes of the robot
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
        self._space = space = pymunk.Space()
        space.iterations = c.SOLVER_ITERATIONS
        space.collision_slop = c.COLLISION_SLOP
        add_walls(space)
        if scene.robot_first:
            robot = add_robot(space, scene.robot, self.dynamics)
        blocks = [
            add_block(space, block, self.dynamics, group=ROBOT_GROUP + 1 + i)
            for i, block in enumerate(scene.blocks)
        ]
        if not scene.robot_first:
            robot = add_robot(space, scene.robot, self.dynamics)
        body, control, gear, fingers, motors, eyes = robot
        self._bodies = [body, *fingers, *eyes, *blocks]
        parts = (space, body, control, gear, *fingers, *motors)
        self.robot = np.array([address(part) for part in parts])
        turns = np.array([address(each) for each in self._bodies])
        places = turns.copy()
        places[3:5] = turns[0]  # eyes have no position of their own
        self.places = np.stack([places, turns], axis=1)
        self._only_row = _ROW, self.robot[None], self.places[None]

    def step(self, action: Sequence[float] | NDArray[np.float64]) -> NDArray[np.float64]:
        """Advance by one control step of 1/8 s.

        Args:
            action: drive, turn and grip, each from -1 to 1; not checked here.

        Returns:
            What `read` returns.
        """
        out = np.empty((1, len(self._bodies), 6))
        actions = np.array([action], np.float64)
        self._kernels.step_rows(*self._only_row, actions, out)
        bodies: NDArray[np.float64] = out[0]
        return bodies

    def read(self) -> NDArray[np.float64]:
        """Pose and velocity of every body.

        Returns:
            A new array (5 + number of blocks, 6) in the rows of `Poses`: x, y, angle and their
            velocities, in units, radians and seconds. Eyes have no position of their own; theirs
            is the robot's.
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
                no effect.

        Raises `InvalidSceneError` for a value that is not finite or beyond `MAX_COORDINATE`.
        """
        furthest = np.abs(bodies).max()
        if not furthest <= c.MAX_COORDINATE:  # also true for NaN
            raise InvalidSceneError(
                f"poses: expected finite numbers up to {c.MAX_COORDINATE:g}, found {furthest:g}"
            )
        for body, row in zip(self._bodies, bodies.tolist(), strict=True):
            x, y, angle, velocity_x, velocity_y, spin = row
            body.position, body.angle = (x, y), angle
            body.velocity, body.angular_velocity = (velocity_x, velocity_y), spin


def add_walls(space: pymunk.Space) -> None:
    """Add four static segments around the workspace."""
    far = c.WORKSPACE_HALF + c.WALL_DISTANCE
    corners = ((-far, far), (far, far), (far, -far), (-far, -far))
    for start, end in zip(corners, corners[1:] + corners[:1], strict=True):
        wall = pymunk.Segment(space.static_body, start, end, c.WALL_RADIUS)
        wall.friction = c.WALL_FRICTION
        space.add(wall)


def add_block(space: pymunk.Space, block: Block, dynamics: Dynamics, group: int) -> pymunk.Body:
    """Add one block with its surface drag; `group` is a collision group for it alone."""
    body = _block_body(block.shape)
    shapes = block_shapes(body, block.shape)
    body.position, body.angle = block.pose[:2], block.pose.angle
    for shape in shapes:
        shape.friction = c.BLOCK_FRICTION
        shape.filter = pymunk.ShapeFilter(group=group)
    pivot = pymunk.PivotJoint(space.static_body, body, (0, 0), (0, 0))
    pivot.max_bias = 0
    pivot.max_force = dynamics.block_pivot_max_force
    gear = pymunk.GearJoint(space.static_body, body, 0.0, 1.0)
    gear.max_bias = 0
    gear.max_force = dynamics.block_gear_max_force
    space.add(body, *shapes, pivot, gear)
    return body


def _block_body(shape: Shape) -> pymunk.Body:
    mass = c.BLOCK_MASS
    if shape == Shape.CIRCLE:
        return pymunk.Body(mass, pymunk.moment_for_circle(mass, 0, c.BLOCK_SIZE))
    outline = block_outline(shape)
    hull = outline[::2] if shape == Shape.STAR else outline  # for a star, the outer vertices
    return pymunk.Body(mass, pymunk.moment_for_poly(mass, hull))


def block_shapes(body: pymunk.Body, shape: Shape) -> list[pymunk.Shape]:
    """The convex shapes of a block, in its body's frame."""
    if shape == Shape.CIRCLE:
        return [pymunk.Circle(body, c.BLOCK_SIZE)]
    if shape == Shape.STAR:
        return [pymunk.Poly(body, part) for part in _star_parts()]
    margin = c.SQUARE_MARGIN if shape == Shape.SQUARE else 0.0
    return [pymunk.Poly(body, block_outline(shape), None, margin)]


@cache
def _star_parts() -> list[list[pymunk.Vec2d]]:
    # Cached: pymunk leaks some 2 kB in every decomposition.
    outline = list(block_outline(Shape.STAR))
    return pymunk.autogeometry.convex_decomposition(outline + outline[:1], 0)


def add_robot(
    space: pymunk.Space, pose: Pose, dynamics: Dynamics
) -> tuple[
    pymunk.Body,
    pymunk.Body,
    pymunk.GearJoint,
    list[pymunk.Body],
    list[pymunk.SimpleMotor],
    list[pymunk.Body],
]:
    """Add the robot.

    Returns:
        Its body, its control body, the gear joint between them, both fingers, their motors, both
        eyes.
    """
    moment = pymunk.moment_for_circle(c.ROBOT_MASS, 0, c.ROBOT_RADIUS)
    body = pymunk.Body(c.ROBOT_MASS, moment)
    body.position, body.angle = pose[:2], pose.angle
    space.add(body)
    control, gear = _add_drive(space, body, pose, dynamics)
    eyes = [_add_eye(space, body, pose) for _ in c.SIDES]
    fingers, motors = zip(
        *(_add_finger(space, body, side, pose, dynamics) for side in c.SIDES), strict=True
    )
    shapes: list[pymunk.Shape] = [pymunk.Circle(body, c.ROBOT_RADIUS)]
    shapes[0].friction = c.ROBOT_FRICTION
    for finger, side in zip(fingers, c.SIDES, strict=True):
        for polygon in finger_polygons(side):
            shapes.append(pymunk.Poly(finger, polygon))
            shapes[-1].friction = c.FINGER_FRICTION
    for shape in shapes:
        shape.filter = pymunk.ShapeFilter(group=ROBOT_GROUP)
        space.add(shape)
    return body, control, gear, list(fingers), list(motors), eyes


def _add_drive(
    space: pymunk.Space, body: pymunk.Body, pose: Pose, dynamics: Dynamics
) -> tuple[pymunk.Body, pymunk.GearJoint]:
    control = pymunk.Body(body_type=pymunk.Body.KINEMATIC)
    control.position, control.angle = pose[:2], pose.angle
    pivot = pymunk.PivotJoint(control, body, (0, 0), (0, 0))
    pivot.max_bias = 0
    pivot.max_force = dynamics.body_pivot_max_force
    gear = pymunk.GearJoint(control, body, 0.0, 1.0)
    gear.error_bias = 0
    gear.max_bias = c.TURN_MAX_BIAS
    gear.max_force = dynamics.body_gear_max_force
    space.add(control, pivot, gear)
    return control, gear


def _add_eye(space: pymunk.Space, body: pymunk.Body, pose: Pose) -> pymunk.Body:
    # The spring's max_force stays unlimited: a limit changes how the robot turns.
    eye = pymunk.Body(c.EYE_MASS, pymunk.moment_for_circle(c.EYE_MASS, 0, c.ROBOT_RADIUS))
    eye.position, eye.angle = pose[:2], pose.angle
    spring = pymunk.DampedRotarySpring(body, eye, 0, c.EYE_SPRING_STIFFNESS, c.EYE_SPRING_DAMPING)
    space.add(eye, spring)
    return eye


def _add_finger(
    space: pymunk.Space, body: pymunk.Body, side: int, pose: Pose, dynamics: Dynamics
) -> tuple[pymunk.Body, pymunk.SimpleMotor]:
    upper, forearm = finger_polygons(side)
    # The polygon through both rectangles' vertices in this order crosses itself; the published
    # moment (0.005006 left, 0.004983 right) is this polygon's.
    finger = pymunk.Body(c.FINGER_MASS, pymunk.moment_for_poly(c.FINGER_MASS, upper + forearm))
    root = (side * c.FINGER_ROOT_X, c.FINGER_ROOT_Y)
    finger.position = finger_position(body, root, pose)
    finger.angle = pose.angle - side * c.FINGER_OPEN
    # A pin joint of zero length, as published; a pivot joint grips visibly differently.
    pin = pymunk.PinJoint(body, finger, root, (0, 0))
    pin.error_bias = 0
    limits = (0.0, c.FINGER_OPEN) if side < 0 else (-c.FINGER_OPEN, 0.0)
    limit = pymunk.RotaryLimitJoint(body, finger, *limits)
    limit.error_bias = 0
    motor = pymunk.SimpleMotor(body, finger, 0)
    motor.max_bias = 0
    motor.max_force = dynamics.finger_motor_max_force
    space.add(finger, pin, limit, motor)
    return finger, motor


# The largest power of two that `finger_position` tries: enough for a robot whose coordinates are 0
# or above 2**-16 units. For others the direction is rounded to about one part in 4096, which
# matters less than a longer pin.
_MAX_POWER = 12


def published_error(root: Point, pose: Pose) -> Point:
    """The vector between a pin joint's anchors at the start, as pymunk 5.6.0 computes it.

    Args:
        root: where the finger is attached, in the robot's frame.
        pose: the robot's pose.

    Returns:
        The rounding error of `pose` + rotated `root`, some 1e-17 units; often 0 in a coordinate.
    """
    root_x, root_y = rotate(root, pose.angle)
    finger_x, finger_y = pose.x + root_x, pose.y + root_y
    return (finger_x - pose.x) - root_x, (finger_y - pose.y) - root_y


def finger_position(body: pymunk.Body, root: Point, pose: Pose) -> Point:
    """The initial position of a finger: its root in the workspace, displaced by some 1e-15 units.

    A pin joint pulls along the line between its anchors. A finger hangs on a pin of zero length, so
    initially this line is a rounding error, normalised. Chipmunk computes it (cpPinJoint.c) as

        (finger + 0) - (robot + root)

    with the root already rotated, which is exactly (0, 0) for a finger placed at robot + root: the
    pin has no direction and does not act in the first substep. pymunk 5.6.0, used by the published
    environments, was compiled with -ffast-math and adds the same terms in the order

        ((finger - robot) + 0) - root

    which is the rounding error of robot + root. Its direction decides how the robot starts to move;
    the first step differs by some 1e-4 units. Here the finger is displaced by a power of two times
    that error, which gives the first expression the published direction to the last bit. The
    smallest power that is a whole number of spacings of floating-point numbers at the finger is
    used, because the effect of the pin's length, which the published one lacks, grows with it. A
    pin joint made afterwards takes the displacement as its length and is at rest.

    Args:
        body: the robot's, already at `pose`.
        root: where the finger is attached, in the robot's frame.
        pose: the robot's pose.
    """
    x, y = body.local_to_world(root)  # as Chipmunk computes it, which is what the pin subtracts
    error_x, error_y = published_error(root, pose)
    for power in range(_MAX_POWER + 1):
        step_x, step_y = 2**power * error_x, 2**power * error_y
        start = x + step_x, y + step_y
        if start[0] - x == step_x and start[1] - y == step_y:
            break
    return start
