"""A control step's substeps, and the reading of all bodies, as one compiled call each.

Bodies, motors and the space are given by their addresses. Values for which Chipmunk has no function
of plain numbers are read and written in a body's memory, at the indices that `chipmunk` has
checked. The interpreter's lock is not held, so threads can step different simulations.
"""

import math
from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from magical.compiled import ADDRESS, FLOAT, c_function, floats_at, inlined, kernel
from magical.physics.chipmunk import ANGLE, POSITION, SPIN, VELOCITY
from magical.physics.robot import motor_rate
from magical.scene import constants as c

rate = inlined(motor_rate)


def compiled_substeps(addresses: Mapping[str, int]) -> Callable[..., None]:
    """The substeps of `Simulation.step`, compiled, with the C functions at these addresses."""
    step_space, set_angle, set_motor_rate = (
        c_function(name, addresses[name], ADDRESS, FLOAT)
        for name in ("cpSpaceStep", "cpBodySetAngle", "cpSimpleMotorSetRate")
    )

    @kernel
    def substeps(
        space: int,
        body: int,
        control: int,
        left: int,
        right: int,
        left_motor: int,
        right_motor: int,
        speed: float,
        lead: float,
        target: float,
    ) -> None:
        for _ in range(c.SUBSTEPS):
            angle = floats_at(body)[ANGLE]
            set_angle(control, angle + lead)
            floats_at(control)[VELOCITY] = -math.sin(angle) * speed
            floats_at(control)[VELOCITY + 1] = math.cos(angle) * speed
            set_motor_rate(left_motor, rate(floats_at(left)[ANGLE] - angle - target))
            set_motor_rate(right_motor, rate(floats_at(right)[ANGLE] - angle + target))
            step_space(space, c.SUBSTEP_TIME)

    return substeps


@kernel
def read(addresses: NDArray[np.int64], out: NDArray[np.float64]) -> None:
    """Write poses and velocities of bodies.

    Args:
        addresses: (bodies, 2): of the bodies that the position and the angle are taken from.
        out: (bodies, 6): x, y, angle and their velocities.
    """
    for i in range(len(addresses)):
        place, turn = addresses[i, 0], addresses[i, 1]
        for k in range(2):
            out[i, k] = floats_at(place)[POSITION + k]
            out[i, 3 + k] = floats_at(place)[VELOCITY + k]
        out[i, 2] = floats_at(turn)[ANGLE]
        out[i, 5] = floats_at(turn)[SPIN]
