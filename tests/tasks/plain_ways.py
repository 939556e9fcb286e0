"""The ways to reach a goal, block by block: what `Goal.ways` computes for many states at once."""

import math
from itertools import combinations, pairwise

from magical.grouping import group_by
from magical.scene import Poses, Region, Scene
from magical.scene.constants import WORKSPACE_HALF
from magical.scene.geometry import Point
from magical.tasks.programs import (
    AtWall,
    Beside,
    Clustered,
    Each,
    Every,
    Exactly,
    Goal,
    InCorner,
    InOwnColour,
    InRegion,
    Lined,
    OneOf,
    Only,
    OutOfRegions,
    Place,
    RobotInside,
    Together,
    Undisturbed,
    value_of,
)
from magical.tasks.programs.goals import UNFINISHED
from magical.tasks.programs.places import CORNER_FULL_SCORE, CORNERS, WALL_ZONE
from magical.tasks.scoring import INLIER_DISTANCE, NEIGHBOUR_DISTANCE, positions

Way = dict[int, float]  # block, or -1 for the robot -> units that it has still to go


def plain_ways(goal: Goal, scene: Scene, poses: Poses) -> list[Way]:
    points = positions(scene, poses)
    if isinstance(goal, Together):
        first, second = (plain_ways(each, scene, poses) for each in (goal.first, goal.second))
        return [{**a, **b} for a in first for b in second]
    if isinstance(goal, Exactly):
        return plain_ways(goal.both, scene, poses)
    if isinstance(goal, Only):
        others = set(range(len(points))) - goal.selection.blocks(scene)
        return [{i: d for i in others if (d := depth_inside(scene, points[i])) > 0.0}]
    if isinstance(goal, Each | Every | OneOf):
        chosen = goal.selection.blocks(scene)
        units = {i: units_to(goal.place, scene, i, points) for i in chosen}
        if not isinstance(goal, OneOf):
            return [{i: left for i, left in units.items() if left > 0.0}]
        return [{i: left} for i, left in units.items()] if all(units.values()) else [{}]
    if isinstance(goal, Undisturbed):
        return [disturbed(goal, scene, points)]
    if isinstance(goal, Lined):
        return ways_to_lines(sorted(goal.selection.blocks(scene)), points)
    if isinstance(goal, Clustered):
        return [to_clusters(goal, scene, poses)]
    assert isinstance(goal, RobotInside)
    left = min(distance_to(region, poses.robot[:2]) for region in scene.regions)
    return [{-1: left} if left > 0.0 else {}]


def work(way: Way) -> float:
    return sum(UNFINISHED + left for left in way.values())


def units_to(place: Place, scene: Scene, block: int, points: list[Point]) -> float:
    x, y = at = points[block]
    if isinstance(place, InRegion):
        return min(distance_to(region, at) for region in scene.regions)
    if isinstance(place, InOwnColour):
        own = [r for r in scene.regions if r.colour == scene.blocks[block].colour]
        return min((distance_to(region, at) for region in own), default=math.inf)
    if isinstance(place, OutOfRegions):
        return depth_inside(scene, at)
    if isinstance(place, InCorner):
        right, top = CORNERS[place.corner]
        corner = right * WORKSPACE_HALF, top * WORKSPACE_HALF
        return max(0.0, math.dist(at, corner) - CORNER_FULL_SCORE)
    if isinstance(place, AtWall):
        along = {"left": -x, "right": x, "bottom": -y, "top": y}[place.wall]
        return max(0.0, WORKSPACE_HALF - WALL_ZONE - along)
    assert isinstance(place, Beside)
    others = place.selection.blocks(scene) - {block}
    nearest = min((math.dist(at, points[i]) for i in others), default=math.inf)
    return max(0.0, nearest - NEIGHBOUR_DISTANCE)


def distance_to(region: Region, point: Point) -> float:
    x, y = point
    across = max(region.x - x, 0.0, x - region.x - region.width)
    return math.hypot(across, max(region.y - region.height - y, 0.0, y - region.y))


def depth_inside(scene: Scene, point: Point) -> float:
    x, y = point
    inside = [region for region in scene.regions if region.contains(x, y)]
    edges = [(x - r.x, r.x + r.width - x, r.y - y, y - r.y + r.height) for r in inside]
    return max(map(min, edges), default=0.0)


def disturbed(goal: Undisturbed, scene: Scene, points: list[Point]) -> Way:
    back: Way = {}
    came = set()
    for region in scene.regions:
        before = {i for i, b in enumerate(scene.blocks) if region.contains(*b.pose[:2])}
        after = {i for i, at in enumerate(points) if region.contains(*at)}
        if before & goal.selection.blocks(scene):
            came |= after - before
            for i in before - after:
                back[i] = max(back.get(i, 0.0), distance_to(region, points[i]))
    return {**back, **{i: depth_inside(scene, points[i]) for i in came}}


def ways_to_lines(chosen: list[int], points: list[Point]) -> list[Way]:
    if len(chosen) < 2:
        return [{-1: math.inf}]
    lines = [
        units_to_line(points[i], points[j], chosen, points) for i, j in combinations(chosen, 2)
    ]
    return [{i: left for i, left in units.items() if left > 0.0} for units in lines]


def units_to_line(a: Point, b: Point, chosen: list[int], points: list[Point]) -> Way:
    length = math.dist(a, b) or 1.0
    ux, uy = (b[0] - a[0]) / length, (b[1] - a[1]) / length
    along = {i: ux * points[i][0] + uy * points[i][1] for i in chosen}
    units = {}
    for i in chosen:
        x, y = points[i][0] - a[0], points[i][1] - a[1]
        units[i] = max(0.0, abs(ux * y - uy * x) - INLIER_DISTANCE)
    for i, j in pairwise(sorted(chosen, key=along.__getitem__)):
        units[j] += max(0.0, along[j] - along[i] - NEIGHBOUR_DISTANCE)
    return units


def to_clusters(goal: Clustered, scene: Scene, poses: Poses) -> Way:
    own, other = goal.distances(scene, poses)
    points = positions(scene, poses)
    way: Way = {}
    if (own < other / 3).all():
        return way
    values = [value_of(block, goal.attribute) for block in scene.blocks]
    for alike in group_by(range(len(points)), values.__getitem__).values():
        ways: list[Way] = []
        for centre in alike:
            gaps = {i: math.dist(points[i], points[centre]) - NEIGHBOUR_DISTANCE for i in alike}
            ways.append({i: left for i, left in gaps.items() if left > 0.0})
        shortest: Way = min(ways, key=work)
        way.update(shortest)
    for i in range(len(points)):
        too_far = math.sqrt(own[i]) - math.sqrt(other[i] / 3)
        if too_far >= 0.0:
            way[i] = way.get(i, 0.0) + too_far
    return way
