"""A state unpacked into plain floats, with transforms to the robot's frame.

Every skill reads this instead of `State`: a state is unpacked once per decision because plain
Python arithmetic is faster than numpy for a dozen bodies.
"""

import math
from dataclasses import dataclass

from magical.scene import FINGERS, FIRST_BLOCK, ROBOT, Point, Scene, State

# s: a released block glides on by about its velocity times this. Measured: 0.08 to 0.16 s for
# carried blocks of all shapes, the lower values at the speeds of a block about to be released.
GLIDE_TIME = 0.09


@dataclass(frozen=True, slots=True)
class StateView:
    """One state: positions in workspace units, angles in radians, rates per second."""

    scene: Scene
    x: float  # of the robot's centre
    y: float
    angle: float
    speed: float  # forwards
    spin: float
    finger_opening: float  # rad, mean of both fingers; FINGER_OPEN when fully open
    cos: float  # of the robot's angle
    sin: float
    blocks: tuple[Point, ...]  # centres, in the scene's order
    resting_blocks: tuple[Point, ...]  # where they would come to rest if released now

    @staticmethod
    def from_state(state: State) -> "StateView":
        """Unpack a state."""
        rows = state.poses.bodies.tolist()
        x, y, angle = rows[ROBOT]
        vx, vy, spin = state.velocities[ROBOT].tolist()
        blocks = tuple((row[0], row[1]) for row in rows[FIRST_BLOCK:])
        velocities = state.velocities[FIRST_BLOCK:].tolist()
        resting = tuple(
            (block[0] + GLIDE_TIME * velocity[0], block[1] + GLIDE_TIME * velocity[1])
            for block, velocity in zip(blocks, velocities, strict=True)
        )
        cos, sin = math.cos(angle), math.sin(angle)
        speed = cos * vy - sin * vx
        opening = 0.5 * (rows[FINGERS.start][2] - rows[FINGERS.start + 1][2])
        return StateView(state.scene, x, y, angle, speed, spin, opening, cos, sin, blocks, resting)

    @property
    def position(self) -> Point:
        """The robot's centre."""
        return self.x, self.y

    def to_robot_frame(self, point: Point) -> Point:
        """The point relative to the robot: x to its right, y ahead."""
        dx, dy = point[0] - self.x, point[1] - self.y
        return self.cos * dx + self.sin * dy, self.cos * dy - self.sin * dx

    def point_ahead(self, distance: float) -> Point:
        """The point `distance` straight ahead of the robot's centre."""
        return self.x - self.sin * distance, self.y + self.cos * distance

    def other_blocks(self, index: int) -> tuple[Point, ...]:
        """The centres of all blocks but one."""
        return (*self.blocks[:index], *self.blocks[index + 1 :])

    def distance_to(self, point: Point) -> float:
        """Distance from the robot's centre to a point."""
        return math.hypot(point[0] - self.x, point[1] - self.y)
