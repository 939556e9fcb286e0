"""Overlap of bodies and regions, decided by pymunk: for placing them and for checking scenes."""

import math
import threading
from collections import defaultdict
from collections.abc import Iterator

import pymunk

from magical.physics import Outline, block_shapes
from magical.scene import Pose, Region, Shape, rectangle, robot_polygons
from magical.scene import constants as c

Kind = Shape | Region | None  # a block, a goal region, the robot with open fingers
AWAY = Pose(1e4, 1e4, 0.0)  # where solids are before they are placed


class Solid:
    """A block, a goal region or the robot, at a pose that may change.

    Attributes:
        beyond_wall: how far it reaches beyond the workspace's edge, in units; negative inside.
    """

    def __init__(self, kind: Kind, group: int) -> None:
        self.kind, self.pose, self.beyond_wall = kind, AWAY, 0.0
        self.body = pymunk.Body(body_type=pymunk.Body.STATIC)
        self.body.position = AWAY[:2]
        self.core = c.BLOCK_SIZE / 2  # the radius of a disc inside it
        outlines: list[Outline] = [
            ((), c.ROBOT_RADIUS),
            *((polygon, 0.0) for polygon in robot_polygons()),
        ]
        if isinstance(kind, Region):
            self.core = min(kind.width, kind.height) / 2
            outlines = [(rectangle(kind.width, kind.height), 0.0)]
        elif kind is not None:
            outlines = block_shapes(kind)
        self.shapes = [
            pymunk.Poly(self.body, outline, None, radius)
            if outline
            else pymunk.Circle(self.body, radius)
            for outline, radius in outlines
        ]
        for shape in self.shapes:
            shape.filter = pymunk.ShapeFilter(group=group)  # does not overlap itself

    def move(self, pose: Pose) -> None:
        """Move it to another pose."""
        self.pose, self.body.position, self.body.angle = pose, pose[:2], pose.angle
        boxes = [shape.cache_bb() for shape in self.shapes]
        reach = max(max(-b.left, b.right, -b.bottom, b.top) for b in boxes)
        self.beyond_wall = reach - c.WORKSPACE_HALF


class Solids(threading.local):
    """Solids, placed one after the other, in a pymunk space that is never stepped.

    A thread's scenes share one: making pymunk's objects would take most of the time.
    """

    def __init__(self) -> None:
        self.space = pymunk.Space()
        self._count = 0
        self._taken: list[Solid] = []
        self._spare: dict[Kind, list[Solid]] = defaultdict(list)

    @staticmethod
    def cleared() -> "Solids":
        """This thread's, with nothing placed."""
        solids = _solids
        for solid in solids._taken:
            if isinstance(solid.kind, Region):  # of its own size
                solids.space.remove(solid.body, *solid.shapes)
            else:
                solid.move(AWAY)
                solids.place(solid)
                solids._spare[solid.kind].append(solid)
        solids._taken.clear()
        return solids

    def take(self, kind: Kind) -> Solid:
        """A solid that is not placed yet."""
        if spare := self._spare[kind]:
            solid = spare.pop()
        else:
            self._count += 1
            solid = Solid(kind, self._count)
            self.space.add(solid.body, *solid.shapes)
        self._taken.append(solid)
        return solid

    def place(self, solid: Solid) -> None:
        """Keep a solid where it has been moved to."""
        self.space.reindex_shapes_for_body(solid.body)

    def overlaps(self, solid: Solid) -> Iterator[tuple[Solid, float]]:
        """The placed solids that another overlaps, with how far, in units; by pairs of shapes."""
        for shape in solid.shapes:
            for hit in self.space.shape_query(shape):
                (other,) = (each for each in self._taken if hit.shape in each.shapes)
                # The sign depends on the order of the two kinds of shapes.
                depth = max(abs(point.distance) for point in hit.contact_point_set.points)
                # Of polygons that coincide, Chipmunk finds none.
                distance = math.dist(other.pose[:2], solid.pose[:2])
                yield other, max(depth, other.core + solid.core - distance)


_solids = Solids()  # of each thread
