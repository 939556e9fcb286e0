"""State vectors: a fixed-length description of a task's true state.

Layout of the float32 vector (poses in workspace units and radians, velocities per second):

- robot, 11: x, y, cos, sin of its angle; its velocity x, y, angular; each finger's angle relative
  to the body (left, right); each finger's angular velocity relative to the body.
- each block slot, 16: presence (0 or 1); shape one-hot (square, circle, pentagon, star); colour
  one-hot (red, green, blue, yellow); x, y, cos, sin of its angle; velocity x, y, angular.
- each region slot, 9: presence; colour one-hot; left x, top y, height, width.

There are as many slots as the task's largest variant needs; unused ones are 0. Blocks and regions
are in the scene's order. `StateSpec.names` lists every entry.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from magical.errors import InvalidSceneError
from magical.observe.spec import EpisodeSource, ObservationSpec, checked
from magical.scene import COLOURS, FINGERS, FIRST_BLOCK, ROBOT, SHAPES, Scene
from magical.scene.constants import WORKSPACE_HALF

STATE = "state"  # the name of this observation

_POSE = ("x", "y", "cos", "sin")
_VELOCITY = ("velocity_x", "velocity_y", "angular_velocity")
_ROBOT = (*_POSE, *_VELOCITY, "left_angle", "right_angle", "left_velocity", "right_velocity")
_KIND = ("present", *SHAPES, *COLOURS)
_BLOCK = (*_KIND, *_POSE, *_VELOCITY)
_REGION = ("present", *COLOURS, "left", "top", "height", "width")


def _bounds(entry: str) -> tuple[float, float]:
    """The smallest and largest value of an entry; only velocities are unbounded."""
    if "velocity" in entry:
        return -np.inf, np.inf
    if entry in _POSE or entry in ("left", "top"):
        return -WORKSPACE_HALF, WORKSPACE_HALF  # also the bounds of sine and cosine
    if entry in ("left_angle", "right_angle"):
        return -np.pi, np.pi
    return 0.0, 2 * WORKSPACE_HALF if entry in ("height", "width") else 1.0


@dataclass(frozen=True)
class StateSpec(ObservationSpec):
    """A state vector with slots for `max_blocks` blocks and `max_regions` regions."""

    max_blocks: int
    max_regions: int

    @property
    def names(self) -> tuple[str, ...]:
        """One name for each entry, such as `robot.x` or `block3.star`."""
        slots: list[tuple[str, tuple[str, ...]]] = [("robot", _ROBOT)]
        slots += [(f"block{i}", _BLOCK) for i in range(self.max_blocks)]
        slots += [(f"region{i}", _REGION) for i in range(self.max_regions)]
        return tuple(f"{slot}.{entry}" for slot, entries in slots for entry in entries)

    @property
    def size(self) -> int:
        """The vector's length."""
        return len(self.names)

    @property
    def space(self) -> spaces.Box:
        entries = (name.split(".")[1] for name in self.names)
        low, high = np.array([_bounds(entry) for entry in entries], np.float32).T
        return spaces.Box(low, high, dtype=np.float32)

    @property
    def num_images(self) -> int:
        return 0

    @property
    def network_shape(self) -> tuple[int, ...]:
        return (self.size,)

    @property
    def components(self) -> "tuple[tuple[StateSpec, int]]":
        return ((self, 1),)  # velocities are part of the vector

    def network_input(self, observations: Any) -> NDArray[Any]:
        return checked(np.asarray(observations), self.network_shape, np.float32)

    def observer(self, out: NDArray[np.float32] | None = None) -> "StateObserver":
        return StateObserver(self, out)

    def read(self, source: EpisodeSource, times: ArrayLike) -> NDArray[np.float32]:
        bodies, observer = source.body_states(), self.observer()
        observer.start(source.scene, bodies[0])
        vectors = np.empty((len(bodies), self.size), np.float32)
        for vector, step in zip(vectors, bodies, strict=True):
            observer.update(step)
            vector[:] = observer.out
        return vectors[np.asarray(times, np.intp)]

    def to_dict(self) -> str:
        return STATE  # the size follows from the task


class StateObserver:
    """Writes a running episode's state vector into a given array, or into a new one."""

    def __init__(self, spec: StateSpec, out: NDArray[np.float32] | None) -> None:
        self.spec = spec
        self.out = np.zeros(spec.size, np.float32) if out is None else out
        blocks_end = len(_ROBOT) + len(_BLOCK) * spec.max_blocks
        self._blocks = self.out[len(_ROBOT) : blocks_end].reshape(-1, len(_BLOCK))
        self._regions = self.out[blocks_end:].reshape(-1, len(_REGION))

    def start(self, scene: Scene, bodies: NDArray[np.float64]) -> None:
        """Start an episode; raises `InvalidSceneError` for a scene with too many bodies."""
        blocks, regions = self.spec.max_blocks, self.spec.max_regions
        if len(scene.blocks) > blocks or len(scene.regions) > regions:
            raise InvalidSceneError(
                f"expected at most {blocks} blocks and {regions} regions for this task's state "
                f"vector, found {len(scene.blocks)} and {len(scene.regions)}; use a pixel "
                "observation or a smaller scene"
            )
        self.out[:] = 0
        for slot, block in zip(self._blocks, scene.blocks, strict=False):
            slot[[0, 1 + SHAPES.index(block.shape), 5 + COLOURS.index(block.colour)]] = 1
        for slot, region in zip(self._regions, scene.regions, strict=False):
            slot[[0, 1 + COLOURS.index(region.colour)]] = 1
            slot[5:] = region.x, region.y, region.height, region.width
        self.update(bodies)

    def update(self, bodies: NDArray[np.float64]) -> None:
        """Observe the next step."""
        turns = bodies[:, 2]
        motion = np.column_stack([bodies[:, :2], np.cos(turns), np.sin(turns), bodies[:, 3:]])
        self.out[:7] = motion[ROBOT]
        self.out[7:11] = (bodies[FINGERS] - bodies[ROBOT])[:, [2, 5]].T.ravel()
        self._blocks[: len(bodies) - FIRST_BLOCK, len(_KIND) :] = motion[FIRST_BLOCK:]
