"""The present true state as plain floats: what every skill of an expert reads.

Numpy is slower than Python for a dozen bodies, so a state is unpacked once for each decision.
"""

import math
from dataclasses import dataclass

from magical.scene import Scene, State
from magical.scene.geometry import Point
from magical.scene.poses import FINGERS, FIRST_BLOCK, ROBOT

GLIDE = 0.09  # s: a block that is let go moves on for about its speed times this


@dataclass(frozen=True, slots=True)
class Sight:
    """One moment; positions in workspace units, angles in radians, rates per second."""

    scene: Scene
    x: float
    y: float
    angle: float
    speed: float  # forwards
    spin: float
    opening: float  # of the fingers, mean; FINGER_OPEN at rest
    cos: float
    sin: float
    blocks: tuple[Point, ...]  # centres, in the scene's order
    resting: tuple[Point, ...]  # where they would come to rest if let go now, about
    steps_left: int

    @staticmethod
    def of(state: State) -> "Sight":
        """Unpack a state."""
        rows = state.poses.bodies.tolist()
        x, y, angle = rows[ROBOT]
        vx, vy, spin = state.velocities[ROBOT].tolist()
        blocks = tuple((row[0], row[1]) for row in rows[FIRST_BLOCK:])
        drift = state.velocities[FIRST_BLOCK:].tolist()
        resting = tuple(
            (x + GLIDE * v[0], y + GLIDE * v[1]) for (x, y), v in zip(blocks, drift, strict=True)
        )
        cos, sin = math.cos(angle), math.sin(angle)
        speed = cos * vy - sin * vx
        left = state.steps_left
        opening = 0.5 * (rows[FINGERS.start][2] - rows[FINGERS.start + 1][2])
        return Sight(
            state.scene, x, y, angle, speed, spin, opening, cos, sin, blocks, resting, left
        )

    def local(self, point: Point) -> Point:
        """A point in the robot's frame: x to its right, y ahead."""
        dx, dy = point[0] - self.x, point[1] - self.y
        return self.cos * dx + self.sin * dy, self.cos * dy - self.sin * dx

    def ahead(self, distance: float, turn: float = 0.0) -> Point:
        """The point at `distance` in the direction `turn` radians to the left of straight ahead."""
        angle = self.angle + turn
        return self.x - math.sin(angle) * distance, self.y + math.cos(angle) * distance

    def distance(self, point: Point) -> float:
        """From the robot's centre to a point."""
        return math.hypot(point[0] - self.x, point[1] - self.y)


def wrap(angle: float) -> float:
    """The same angle in [-pi, pi)."""
    return (angle + math.pi) % (2 * math.pi) - math.pi


def bearing(start: Point, end: Point) -> float:
    """The angle of a robot at `start` that faces `end` (0 is up, counter-clockwise)."""
    return math.atan2(start[0] - end[0], end[1] - start[1])


def inside(point: Point, limit: float) -> bool:
    """Whether both coordinates are at most `limit` in size."""
    return abs(point[0]) <= limit and abs(point[1]) <= limit
