"""Chipmunk through pymunk's private bindings: the only file that uses them.

Through pymunk's properties, the ten control-law updates and the one read of all bodies in a control
step would take a third of its time. The private names used here may change between releases,
so importing this module checks that pymunk's version is in the range they were tested with.
"""

import re
from collections.abc import Sequence
from typing import Any

import numpy as np
import pymunk
import pymunk.batch
from numpy.typing import NDArray

from magical.errors import DependencyVersionError
from magical.scene.poses import EYES, ROBOT

TESTED_VERSIONS = ((7, 3), (7, 4))  # from the first, below the second; pyproject.toml has the same


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

from pymunk._chipmunk_cffi import ffi, lib  # noqa: E402

get_angle = lib.cpBodyGetAngle
set_angle = lib.cpBodySetAngle
set_velocity = lib.cpBodySetVelocity
set_motor_rate = lib.cpSimpleMotorSetRate

_FIELDS = (
    pymunk.batch.BodyFields.POSITION
    | pymunk.batch.BodyFields.ANGLE
    | pymunk.batch.BodyFields.VELOCITY
    | pymunk.batch.BodyFields.ANGULAR_VELOCITY
)
_WIDTH = 6  # floats read for each body: x, y, angle and their velocities
# The static body is visited too, and pymunk would move a full buffer to memory of its own.
_SPARE = 4
_POSITION_COLUMNS = [0, 1, 3, 4]  # columns of a body's position and its velocity


def body_handle(body: pymunk.Body) -> Any:
    """What `get_angle`, `set_angle` and `set_velocity` take."""
    return body._body


def motor_handle(motor: pymunk.SimpleMotor) -> Any:
    """What `set_motor_rate` takes."""
    return motor._constraint


class BodyReader:
    """Reads poses and velocities of chosen bodies of a space in one call.

    No body may be added to the space afterwards. pymunk's own batch buffers allocate memory that
    is never freed; this class reads into an array of its own, made large enough beforehand.
    """

    def __init__(self, space: pymunk.Space, bodies: Sequence[pymunk.Body]) -> None:
        """`bodies` in the rows of `Poses`."""
        count = len(space.bodies) + _SPARE
        self._space = space
        self._all = np.empty(count * _WIDTH)
        self._ids = np.empty(count, np.uintp)
        self._floats = ffi.new("pmFloatArray *")
        self._floats.arr = ffi.from_buffer("cpFloat[]", self._all)
        self._floats.max = self._all.size
        self._ints = ffi.new("pmIntArray *")
        self._ints.arr = ffi.from_buffer("uintptr_t[]", self._ids)
        self._ints.max = self._ids.size
        self._target = ffi.new("pmBatchedData *")
        self._target.floatArray, self._target.intArray = self._floats, self._ints
        self._visit = ffi.addressof(lib, "pmSpaceBodyGetIteratorFuncBatched")
        self._target.fields = pymunk.batch.BodyFields.BODY_ID.value
        lib.cpSpaceEachBody(space._space, self._visit, self._target)
        assert self._ints.num < self._ints.max == self._ids.size
        ids = self._ids[: self._ints.num].tolist()
        rows = np.array([ids.index(body.id) for body in bodies])
        # The index in the buffer of each entry of the result, (bodies, 6).
        self._indices = rows[:, None] * _WIDTH + np.arange(_WIDTH)
        self._indices[EYES, _POSITION_COLUMNS] = self._indices[ROBOT, _POSITION_COLUMNS]
        self._target.fields = _FIELDS.value

    def read(self) -> NDArray[np.float64]:
        """x, y, angle and their velocities, (bodies, 6).

        Eyes have no position of their own; theirs is the robot's.
        """
        self._floats.num = 0
        lib.cpSpaceEachBody(self._space._space, self._visit, self._target)
        return self._all.take(self._indices, mode="clip")
