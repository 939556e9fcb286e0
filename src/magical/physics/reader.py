"""Poses and velocities of a space's bodies, read in one call."""

from collections.abc import Sequence

import numpy as np
import pymunk
import pymunk.batch
from numpy.typing import NDArray
from pymunk._chipmunk_cffi import ffi, lib

from magical.scene.poses import EYES, ROBOT

_FIELDS = (
    pymunk.batch.BodyFields.POSITION
    | pymunk.batch.BodyFields.ANGLE
    | pymunk.batch.BodyFields.VELOCITY
    | pymunk.batch.BodyFields.ANGULAR_VELOCITY
)
_WIDTH = 6  # floats read for each body: x, y, angle and their velocities
# The static body is visited too, and pymunk would move a full buffer to memory of its own.
_SPARE = 4
_PLACE = [0, 1, 3, 4]  # columns of a body's place and its velocity


class BodyReader:
    """Reads chosen bodies of a space, to which none may be added afterwards.

    pymunk's own batch buffers allocate memory that is never freed; this one reads into an array of
    its own, made large enough beforehand.
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
        self._places = self._find(bodies)
        self._target.fields = _FIELDS.value

    def read(self) -> NDArray[np.float64]:
        """x, y, angle and their velocities, (bodies, 6).

        Eyes have no place of their own; theirs is the robot's.
        """
        self._floats.num = 0
        lib.cpSpaceEachBody(self._space._space, self._visit, self._target)
        return self._all.take(self._places, mode="clip")

    def _find(self, bodies: Sequence[pymunk.Body]) -> NDArray[np.intp]:
        """Where in what is read each entry of the result is, (bodies, 6)."""
        self._target.fields = pymunk.batch.BodyFields.BODY_ID.value
        lib.cpSpaceEachBody(self._space._space, self._visit, self._target)
        ids = self._ids[: self._ints.num].tolist()
        rows = np.array([ids.index(body.id) for body in bodies])
        assert self._ints.num < self._ints.max == self._ids.size
        places = rows[:, None] * _WIDTH + np.arange(_WIDTH)
        places[EYES, _PLACE] = places[ROBOT, _PLACE]
        return places
