"""The state vector: a fixed-length description of a task's true state for learners.

Layout of the float32 vector (poses in workspace units and radians, velocities per second):

- robot, 11: x, y, cos, sin of its angle; its velocity x, y, angular; each finger's angle relative
  to the body (left, right); each finger's angular velocity relative to the body.
- each block slot, 16: presence (0 or 1); shape one-hot (square, circle, pentagon, star); colour
  one-hot (red, green, blue, yellow); x, y, cos, sin of its angle; velocity x, y, angular.
- each region slot, 9: presence; colour one-hot; left x, top y, height, width.

There are as many slots as the task's fullest variant needs; the rest are all 0. Blocks and regions
stand in the scene's order. `StateLayout.names` spells every entry.
"""

from dataclasses import dataclass

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from magical.errors import InvalidSceneError
from magical.scene.poses import FINGERS, FIRST_BLOCK, ROBOT
from magical.scene.scene import Scene
from magical.scene.vocabulary import COLOURS, SHAPES

_POSE = ("x", "y", "cos", "sin")
_VELOCITY = ("velocity_x", "velocity_y", "angular_velocity")
_ROBOT = (*_POSE, *_VELOCITY, "left_angle", "right_angle", "left_velocity", "right_velocity")
_KIND = ("present", *SHAPES, *COLOURS)
_BLOCK = (*_KIND, *_POSE, *_VELOCITY)
_REGION = ("present", *COLOURS, "left", "top", "height", "width")


@dataclass(frozen=True, slots=True)
class StateLayout:
    """How many block and region slots a task's state vector has."""

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
        return len(_ROBOT) + len(_BLOCK) * self.max_blocks + len(_REGION) * self.max_regions

    @property
    def space(self) -> spaces.Box:
        """The Gymnasium space of the vector."""
        return spaces.Box(-np.inf, np.inf, (self.size,), np.float32)

    def check(self, scene: Scene) -> None:
        """Raise `InvalidSceneError` if the scene has more blocks or regions than slots."""
        if len(scene.blocks) > self.max_blocks or len(scene.regions) > self.max_regions:
            raise InvalidSceneError(
                f"expected at most {self.max_blocks} blocks and {self.max_regions} regions for "
                f"this task's state vector, found {len(scene.blocks)} and {len(scene.regions)}; "
                "use a pixel observation or a smaller scene"
            )


class StateObserver:
    """Writes one world's state vector into an array it is given, or into one of its own."""

    def __init__(self, layout: StateLayout, out: NDArray[np.float32] | None = None) -> None:
        self.layout = layout
        self.out = np.zeros(layout.size, np.float32) if out is None else out
        blocks_end = len(_ROBOT) + len(_BLOCK) * layout.max_blocks
        self._blocks = self.out[len(_ROBOT) : blocks_end].reshape(-1, len(_BLOCK))
        self._regions = self.out[blocks_end:].reshape(-1, len(_REGION))

    def start(self, scene: Scene, table: NDArray[np.float64]) -> None:
        """Begin an episode; `table` is (5 + blocks, 6): x, y, angle and their velocities."""
        self.layout.check(scene)
        self.out[:] = 0
        for slot, block in zip(self._blocks, scene.blocks, strict=False):
            slot[[0, 1 + SHAPES.index(block.shape), 5 + COLOURS.index(block.colour)]] = 1
        for slot, region in zip(self._regions, scene.regions, strict=False):
            slot[[0, 1 + COLOURS.index(region.colour)]] = 1
            slot[5:] = region.x, region.y, region.height, region.width
        self.update(table)

    def update(self, table: NDArray[np.float64]) -> None:
        """Show the next moment."""
        self._write(self.out[:7], table[ROBOT])
        relative = table[FINGERS] - table[ROBOT]
        self.out[7:9] = relative[:, 2]
        self.out[9:11] = relative[:, 5]
        blocks = table[FIRST_BLOCK:]
        self._write(self._blocks[: len(blocks), len(_KIND) :], blocks)

    def copy(self) -> NDArray[np.float32]:
        """The vector, in memory of its own."""
        return self.out.copy()

    @staticmethod
    def _write(out: NDArray[np.float32], rows: NDArray[np.float64]) -> None:
        out[..., 0:2] = rows[..., 0:2]
        np.cos(rows[..., 2], out=out[..., 2], casting="same_kind")
        np.sin(rows[..., 2], out=out[..., 3], casting="same_kind")
        out[..., 4:7] = rows[..., 3:6]
