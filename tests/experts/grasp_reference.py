"""The costs of grasps, slowly: one block, one side and one obstacle at a time."""

import math
from collections.abc import Sequence

from magical.experts import grasp as g
from magical.experts.geometry import (
    BACK_STEP,
    CONTACT_DISTANCE,
    DRIVE_STEP,
    DRIVING_CLEARANCE,
    HELD_DISTANCE,
    ROBOT_LIMIT,
    TURN_STEP,
    bearing,
    is_within,
    segment_distance,
    wrap_angle,
)
from magical.experts.grasp import gate_point, point_behind
from magical.experts.state_view import StateView
from magical.scene.geometry import Point


def grasp_cost(
    view: StateView, block: Point, goal: Point, others: Sequence[Point], side: float
) -> float:
    """Control steps until a block, grasped from a side, is at its goal."""
    gate = gate_point(block, side)
    gaps = [segment_distance(view.position, gate, other) for other in others]
    return (
        approach_steps(view, block, gate, side)
        + g.PATH_COST * sum(max(0.0, DRIVING_CLEARANCE - gap) for gap in gaps)
        + wall_cost(block, side)
        + sum(block_cost(block, side, other) for other in others)
        + carry_steps(block, side, goal)
    )


def wall_cost(block: Point, side: float) -> float:
    """What walls at the stand, the gate and the fingers cost."""
    stand, gate = point_behind(block, side, HELD_DISTANCE), gate_point(block, side)
    cost = g.STAND_WALL_COST * outside(stand) + g.GATE_WALL_COST * outside(gate)
    for finger in fingers(block, side):
        if not is_within(finger, g.FINGER_LIMIT):
            cost += g.FINGER_WALL_COST
    return cost


def block_cost(block: Point, side: float, other: Point) -> float:
    """What another block costs that is near the straight approach or a finger."""
    stand, gate = point_behind(block, side, HELD_DISTANCE), gate_point(block, side)
    missing = max(0.0, CONTACT_DISTANCE - segment_distance(stand, gate, other))
    for finger in fingers(block, side):
        missing += max(0.0, g.FINGER_ROOM - math.dist(finger, other))
    return g.NEIGHBOUR_COST * missing


def fingers(block: Point, side: float) -> tuple[Point, Point]:
    """Where the two fingers are around a block that is held."""
    dx, dy = g.FINGER_OFFSET * math.cos(side), g.FINGER_OFFSET * math.sin(side)
    return (block[0] + dx, block[1] + dy), (block[0] - dx, block[1] - dy)


def outside(point: Point) -> float:
    """By how much the robot's centre would be too near to a wall."""
    return max(0.0, abs(point[0]) - ROBOT_LIMIT, abs(point[1]) - ROBOT_LIMIT)


def approach_steps(view: StateView, block: Point, gate: Point, side: float) -> float:
    """Control steps until the robot holds the block."""
    here, away = view.position, view.distance_to(block)
    straight = bearing(here, block)
    if abs(wrap_angle(straight - side)) < g.CONE:
        turn = abs(wrap_angle(straight - view.angle))
        retreat = max(0.0, g.SWEEP_RADIUS - away) if turn > g.MISAIMED else 0.0
        return drive_steps(away - HELD_DISTANCE + 2 * retreat, turn)
    heading = bearing(here, gate)
    narrow = max(0.0, DRIVING_CLEARANCE - segment_distance(here, gate, block))
    detour = g.DETOUR * narrow / DRIVING_CLEARANCE
    turn = abs(wrap_angle(heading - view.angle)) + abs(wrap_angle(side - heading))
    return drive_steps(math.dist(here, gate) + detour + g.GATE_DISTANCES[0] - HELD_DISTANCE, turn)


def drive_steps(distance: float, turn: float) -> float:
    """Control steps of a drive."""
    return distance / DRIVE_STEP + turn / TURN_STEP


def carry_steps(block: Point, side: float, goal: Point) -> float:
    """Control steps to push or pull the block to its goal."""
    stand, distance = point_behind(block, side, HELD_DISTANCE), math.dist(block, goal)
    turn = abs(wrap_angle(bearing(stand, goal) - side))
    pushing = distance / DRIVE_STEP + g.CARRYING_TURN * turn / TURN_STEP
    turn = abs(wrap_angle(bearing(goal, block) - side))
    pulling = distance / BACK_STEP + g.CARRYING_TURN * turn / TURN_STEP + g.PULL_STEPS
    return min(pushing, pulling)
