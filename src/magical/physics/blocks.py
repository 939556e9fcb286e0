"""Blocks and walls in a pymunk space (docs/specification.md, sections 3 and 4)."""

from functools import cache

import pymunk
import pymunk.autogeometry

from magical.scene import constants as c
from magical.scene.geometry import block_outline
from magical.scene.scene import Block, Dynamics
from magical.scene.vocabulary import Shape


def add_walls(space: pymunk.Space) -> None:
    """Add four static segments around the workspace."""
    far = c.WORKSPACE_HALF + c.WALL_DISTANCE
    corners = ((-far, far), (far, far), (far, -far), (-far, -far))
    for start, end in zip(corners, corners[1:] + corners[:1], strict=True):
        wall = pymunk.Segment(space.static_body, start, end, c.WALL_RADIUS)
        wall.friction = c.WALL_FRICTION
        space.add(wall)


def add_block(space: pymunk.Space, block: Block, dynamics: Dynamics, group: int) -> pymunk.Body:
    """Add one block with its surface drag; `group` is a collision group for it alone."""
    body, shapes = _make(block.shape)
    body.position, body.angle = block.pose[:2], block.pose.angle
    for shape in shapes:
        shape.friction = c.BLOCK_FRICTION
        shape.filter = pymunk.ShapeFilter(group=group)
    pivot = pymunk.PivotJoint(space.static_body, body, (0, 0), (0, 0))
    pivot.max_bias = 0
    pivot.max_force = dynamics.block_pivot_max_force
    gear = pymunk.GearJoint(space.static_body, body, 0.0, 1.0)
    gear.max_bias = 0
    gear.max_force = dynamics.block_gear_max_force
    space.add(body, *shapes, pivot, gear)
    return body


def _make(shape: Shape) -> tuple[pymunk.Body, list[pymunk.Shape]]:
    mass = c.BLOCK_MASS
    if shape == Shape.CIRCLE:
        body = pymunk.Body(mass, pymunk.moment_for_circle(mass, 0, c.BLOCK_SIZE))
        return body, [pymunk.Circle(body, c.BLOCK_SIZE)]
    outline = block_outline(shape)
    hull = outline[::2] if shape == Shape.STAR else outline  # for a star, the outer vertices
    body = pymunk.Body(mass, pymunk.moment_for_poly(mass, hull))
    if shape == Shape.STAR:
        return body, [pymunk.Poly(body, part) for part in _star_parts()]
    margin = c.SQUARE_MARGIN if shape == Shape.SQUARE else 0.0
    return body, [pymunk.Poly(body, outline, None, margin)]


@cache
def _star_parts() -> list[list[pymunk.Vec2d]]:
    # Cached: pymunk leaks some 2 kB in every decomposition.
    outline = list(block_outline(Shape.STAR))
    return pymunk.autogeometry.convex_decomposition(outline + outline[:1], 0)
