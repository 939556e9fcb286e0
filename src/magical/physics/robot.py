"""The robot's bodies, joints and shapes, and its control law.

Source: docs/specification.md, section 2.
"""

import math

import numpy as np
import pymunk

from magical.physics.pins import finger_position
from magical.scene import constants as c
from magical.scene.actions import POINTS, AnyAction
from magical.scene.geometry import finger_polygons
from magical.scene.scene import Dynamics, Pose

ROBOT_GROUP = 1  # collision group shared by all shapes of the robot

# Drive speed (units / s), lead of the control body (rad) and finger target (rad), which are set
# before every substep; and the joint's limit on the turning rate (rad / s).
Command = tuple[tuple[float, float, float], float]


def command(action: AnyAction) -> Command:
    """The command of an action: speed, turning rate and finger target vary linearly with its parts.

    The joint between control body and robot turns as fast as its limit allows whenever the lead
    exceeds a few hundredths, so a fraction of full turning scales the limit, not the lead.
    """
    drive, turn, grip = POINTS[action] if isinstance(action, (int, np.integer)) else action
    speed = drive * (c.DRIVE_SPEED_FORWARD if drive > 0.0 else -c.DRIVE_SPEED_BACK)
    target = c.FINGER_OPEN * (1.0 - grip) / 2.0
    if turn == 0.0:  # the joint holds the angle, with its full limit
        return (speed, 0.0, target), c.TURN_MAX_BIAS
    return (speed, math.copysign(c.TURN_LEAD, turn), target), abs(turn) * c.TURN_MAX_BIAS


COMMANDS = tuple(command(number) for number in range(len(POINTS)))  # of the discrete actions


class Robot:
    """The robot in a pymunk space, and its control law for a `Command`."""

    def __init__(self, space: pymunk.Space, pose: Pose, dynamics: Dynamics) -> None:
        moment = pymunk.moment_for_circle(c.ROBOT_MASS, 0, c.ROBOT_RADIUS)
        self.body = pymunk.Body(c.ROBOT_MASS, moment)
        self.body.position, self.body.angle = pose[:2], pose.angle
        space.add(self.body)
        self.control, self.gear = _add_drive(space, self.body, pose, dynamics)
        self.eyes = [_add_eye(space, self.body, pose) for _ in c.SIDES]
        fingers = [_add_finger(space, self.body, side, pose, dynamics) for side in c.SIDES]
        self.fingers = [finger for finger, _ in fingers]
        self.motors = [motor for _, motor in fingers]
        shapes: list[pymunk.Shape] = [pymunk.Circle(self.body, c.ROBOT_RADIUS)]
        shapes[0].friction = c.ROBOT_FRICTION
        for finger, side in zip(self.fingers, c.SIDES, strict=True):
            for polygon in finger_polygons(side):
                shapes.append(pymunk.Poly(finger, polygon))
                shapes[-1].friction = c.FINGER_FRICTION
        for shape in shapes:
            shape.filter = pymunk.ShapeFilter(group=ROBOT_GROUP)
            space.add(shape)

    def steer(self, speed: float, lead: float, target: float) -> None:
        """Set the control body and the finger motors; called before every substep."""
        angle = self.body.angle
        self.control.angle = angle + lead
        self.control.velocity = -math.sin(angle) * speed, math.cos(angle) * speed
        for finger, motor, side in zip(self.fingers, self.motors, c.SIDES, strict=True):
            motor.rate = motor_rate(finger.angle - angle + side * target)


def motor_rate(error: float) -> float:
    """A finger motor's rate (rad / s) for a finger `error` radians from its target."""
    rate = c.FINGER_GAIN * error
    if rate >= c.FINGER_MAX_RATE:
        return c.FINGER_MAX_RATE
    if rate <= -c.FINGER_MAX_RATE:
        return -c.FINGER_MAX_RATE
    return rate if abs(rate) >= c.FINGER_DEAD_RATE else 0.0


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
