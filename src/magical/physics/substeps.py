"""Control steps of any number of simulations as one compiled call.

Spaces, bodies and joints are given by their addresses. Names, signatures and layout of Chipmunk's C
functions and structs are private to pymunk and may change between releases, so importing this
module checks them once. pymunk's public functions step at the same motions, but take a third
longer, and hold the interpreter's lock between substeps; here threads can step different
simulations at the same time.
"""

import math
from typing import Any

import numpy as np
import pymunk
from numpy.typing import NDArray
from pymunk._chipmunk_cffi import ffi, lib

from magical.compiled import ADDRESS, FLOAT, c_function, floats_at, inlined, kernel
from magical.errors import MissingDependencyError
from magical.scene import constants as c

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


def address(part: Any) -> int:
    """The address of Chipmunk's struct of a space, a body or a joint."""
    return int(ffi.cast("intptr_t", part))


def c_functions() -> list[Any]:
    """The functions in `SIGNATURES`, for kernels to call.

    Raises:
        MissingDependencyError: pymunk lacks one of them, one has other arguments, or a body has
            another layout in memory.
    """
    body = pymunk.Body(2.0, 4.0)
    body.position, body.velocity = (5.0, 6.0), (7.0, 8.0)
    body.angle, body.angular_velocity = 9.0, 10.0
    size = 8 * (POINTERS + len(LAYOUT))
    memory = np.frombuffer(ffi.buffer(ffi.cast("char *", body._body), size))
    functions = {name: ffi.addressof(lib, name) for name in SIGNATURES if hasattr(lib, name)}
    found = {name: ffi.typeof(function).cname for name, function in functions.items()}
    if found != SIGNATURES or memory[POINTERS:].tolist() != LAYOUT:
        raise MissingDependencyError(
            f"expected the C functions and bodies of pymunk 7.3, found others in pymunk "
            f"{pymunk.version}; pip install 'pymunk>=7.3,<7.4'"
        )
    addresses = [(name, int(ffi.cast("intptr_t", f))) for name, f in functions.items()]
    return [c_function(name, value, ADDRESS, FLOAT) for name, value in addresses]


step_space, set_angle, set_motor_rate, set_max_bias = c_functions()


@inlined
def motor_rate(error: float) -> float:
    """A finger motor's rate (rad / s) for a finger `error` radians from its target."""
    rate = min(max(c.FINGER_GAIN * error, -c.FINGER_MAX_RATE), c.FINGER_MAX_RATE)
    return rate if abs(rate) >= c.FINGER_DEAD_RATE else 0.0


@inlined
def read_bodies(places: NDArray[np.int64], out: NDArray[np.float64]) -> None:
    """Read poses and velocities (most, 6) of the bodies at addresses (most, 2); 0 ends these."""
    for i in range(len(places)):
        place, turn = places[i, 0], places[i, 1]
        if place == 0:
            break
        for k in range(2):
            out[i, k] = floats_at(place)[POSITION + k]
            out[i, 3 + k] = floats_at(place)[VELOCITY + k]
        out[i, 2] = floats_at(turn)[ANGLE]
        out[i, 5] = floats_at(turn)[SPIN]


@kernel
def read_one(places: NDArray[np.int64], out: NDArray[np.float64]) -> None:
    """Read all bodies of one simulation."""
    read_bodies(places, out)


@kernel
def step_rows(
    rows: NDArray[np.int64],
    robots: NDArray[np.int64],
    places: NDArray[np.int64],
    actions: NDArray[np.float64],
    out: NDArray[np.float64],
) -> None:
    """Take a control step in some of N simulations, and read their bodies.

    Args:
        rows: (R,): which simulations.
        robots: (N, 8): addresses of the space, the robot's body, its control body, the gear joint
            between them, the fingers and their motors.
        places: (N, most, 2): of the bodies that each row's position and angle are read from.
        actions: (N, 3): drive, turn and grip, each from -1 to 1.
        out: (N, most, 6): x, y, angle and their velocities.
    """
    for row in rows:
        space, body, control, gear = robots[row, 0], robots[row, 1], robots[row, 2], robots[row, 3]
        left, right, left_motor, right_motor = robots[row, 4:]
        drive, turn, grip = actions[row]
        speed = drive * (c.DRIVE_SPEED_FORWARD if drive > 0.0 else -c.DRIVE_SPEED_BACK)
        target = c.FINGER_OPEN * (1.0 - grip) / 2.0
        # The joint turns the robot as fast as its limit allows whenever the control body is ahead
        # by more than a few hundredths, so a fraction of full turning scales the limit.
        lead, limit = 0.0, c.TURN_MAX_BIAS
        if turn != 0.0:
            lead, limit = math.copysign(c.TURN_LEAD, turn), abs(turn) * c.TURN_MAX_BIAS
        set_max_bias(gear, limit)
        for _ in range(c.SUBSTEPS):
            angle = floats_at(body)[ANGLE]
            set_angle(control, angle + lead)
            floats_at(control)[VELOCITY] = -math.sin(angle) * speed
            floats_at(control)[VELOCITY + 1] = math.cos(angle) * speed
            set_motor_rate(left_motor, motor_rate(floats_at(left)[ANGLE] - angle - target))
            set_motor_rate(right_motor, motor_rate(floats_at(right)[ANGLE] - angle + target))
            step_space(space, c.SUBSTEP_TIME)
        read_bodies(places[row], out[row])
