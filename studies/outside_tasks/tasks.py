"""Twelve tasks whose goals the language of `magical_goals` cannot express, with experts.

They are for learners of goals: what such a learner does with a goal that it has no words for. The
language has no place relative to the workspace's centre, to a block's start or beside a region, no
colour of one block that says where another goes, no block that must stay where it was outside a
region, and no end place of the robot beside a block. It is not to be extended by them.

`DEVELOPMENT` may be used in any way. `HELD_BACK` is for evaluations of what was settled before.

    magical evaluate expert --import studies/outside_tasks/tasks.py --task Centre

A final state scores 1 or 0. In all tasks but `Apart` the square is the block to move.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

import magical
from magical.experts import Move, MovePlan, Planner, StateView, Strategy, register_planner
from magical.experts.geometry import segment_distance
from magical.scene import COLOURS, Block, Colour, Point, Pose, Poses, Region, Scene, Shape
from magical.tasks import Axis, Task
from magical.tasks.scoring import positions

NEAR = 0.2  # units from a place within which a block is there
ROBOT_NEAR = 0.7  # units between the centres of robot and block; they touch at 0.32
UNTOUCHED = 0.1  # units by which a block that must stay may move
SHORT = (0.05, 0.4)  # units between a block's centre and a region, if it stops short of it
APART = 1.2  # units between two blocks
CLEAR = 0.35  # units between the way to a region and blocks that must not be moved
TOLERANCE = 0.07  # units from its goal within which the expert sets a block down
LIMIT = 0.8  # units: largest coordinate of a place
OUTSIDE = (2.0, 2.0)  # of the workspace: no place fits
AXES = Axis.JITTER | Axis.LAYOUT | Axis.COLOUR | Axis.DYNAMICS
SQUARE, CIRCLE = 0, 1  # rows of blocks

Places = Mapping[int, Point]  # where blocks should go
Check = Callable[[Scene, list[Point], Point], bool]  # of the scene, blocks' and robot's positions


@dataclass(frozen=True)
class Rule:
    """One task: where the expert brings what, and when the goal is reached."""

    summary: str
    demo: Scene
    places: Callable[[Scene], Places]
    is_reached: Check
    fits: Callable[[Scene], bool] = lambda scene: True
    horizon: int = 80  # control steps
    then: int | None = None  # the block that the robot drives to at the end


def at(place: Point, point: Point) -> bool:
    """Whether a block's position is near a place."""
    return math.dist(place, point) < NEAR


def region_centre(scene: Scene, index: int = 0) -> Point:
    """The centre of one of the scene's regions."""
    return scene.regions[index].centre


def start(scene: Scene, block: int) -> Point:
    """Where a block starts."""
    return scene.blocks[block].pose.x, scene.blocks[block].pose.y


def midway(a: Point, b: Point) -> Point:
    """The point half way between two."""
    return (a[0] + b[0]) / 2, (a[1] + b[1]) / 2


def gap(region: Region, point: Point) -> float:
    """The distance of a point from a region; 0 inside."""
    x, y = region.centre
    return math.hypot(
        max(abs(point[0] - x) - region.width / 2, 0.0),
        max(abs(point[1] - y) - region.height / 2, 0.0),
    )


def edge_point(region: Region, outside: Point, distance: float) -> Point:
    """A point at a distance from a region, on the way from its centre to a point outside."""
    centre, low, high = region.centre, 0.0, 1.0
    for _ in range(30):
        middle = (low + high) / 2
        x, y = (c + middle * (o - c) for c, o in zip(centre, outside, strict=True))
        low, high = (middle, high) if gap(region, (x, y)) < distance else (low, middle)
    return x, y


def of_star(scene: Scene) -> Region:
    """The region that has the star's colour."""
    (star,) = (block for block in scene.blocks if block.shape == Shape.STAR)
    return next(region for region in scene.regions if region.colour == star.colour)


def smaller(scene: Scene) -> Region:
    """The region with the smaller area."""
    return min(scene.regions, key=lambda region: region.width * region.height)


def beside(region: Region) -> Point:
    """The place to the left of a region."""
    x, y = region.centre
    return x - region.width / 2 - 0.22, y


def apart(scene: Scene) -> Point:
    """Where to bring the square, away from the circle and inside the walls."""
    grid = [(x, y) for x in (-LIMIT, 0.0, LIMIT) for y in (-LIMIT, 0.0, LIMIT)]
    far = [p for p in grid if math.dist(p, start(scene, CIRCLE)) > APART + TOLERANCE + 0.05]
    return min(far, key=lambda p: math.dist(p, start(scene, SQUARE)), default=OUTSIDE)


def stayed(scene: Scene, points: list[Point], *moved: int) -> bool:
    """Whether all blocks but those that were to be moved are where they were."""
    others = set(range(len(points))) - set(moved)
    return all(math.dist(points[i], start(scene, i)) < UNTOUCHED for i in others)


def scene(robot: Pose, blocks: tuple[Block, ...], *regions: Region) -> Scene:
    """A Demo scene."""
    return Scene(robot=robot, blocks=blocks, regions=regions)


def block(shape: Shape, colour: Colour, x: float, y: float, angle: float = 0.0) -> Block:
    """A block of a Demo scene."""
    return Block(shape, colour, Pose(x, y, angle))


def region(colour: Colour, x: float, y: float, height: float = 0.55, width: float = 0.6) -> Region:
    """A region of a Demo scene, from its centre."""
    return Region.from_centre(colour, x, y, height, width)


R, G, B, Y = Colour.RED, Colour.GREEN, Colour.BLUE, Colour.YELLOW
BLOCKS = (
    block(Shape.SQUARE, R, 0.6, -0.2, 0.4),
    block(Shape.CIRCLE, B, -0.75, -0.6),
    block(Shape.PENTAGON, G, 0.1, 0.75, 1.0),
)
ROBOT = Pose(0.15, -0.7, 0.3)

DEVELOPMENT = {
    "Centre": Rule(
        "Push the square to the middle of the workspace.",
        scene(ROBOT, BLOCKS),
        places=lambda s: {SQUARE: (0.0, 0.0)},
        is_reached=lambda s, points, robot: at((0.0, 0.0), points[SQUARE]),
    ),
    "Between": Rule(
        "Push the square half way between the two regions.",
        scene(ROBOT, BLOCKS[:2], region(B, -0.6, 0.1), region(Y, 0.5, 0.65)),
        places=lambda s: {SQUARE: midway(region_centre(s), region_centre(s, 1))},
        is_reached=lambda s, points, robot: at(
            midway(region_centre(s), region_centre(s, 1)), points[SQUARE]
        ),
    ),
    "StarsRegion": Rule(
        "Push the square into the region that has the star's colour.",
        scene(
            ROBOT,
            (BLOCKS[0], block(Shape.STAR, B, -0.7, -0.65)),
            region(Y, 0.5, 0.6),
            region(B, -0.5, 0.3),
        ),
        places=lambda s: {SQUARE: of_star(s).centre},
        is_reached=lambda s, points, robot: of_star(s).contains(*points[SQUARE]),
        fits=lambda s: (
            len({r.colour for r in s.regions}) == 2
            and s.blocks[1].colour in {r.colour for r in s.regions}
        ),
    ),
    "LeaveOthers": Rule(
        "Push the square into the region. Do not move the other blocks.",
        scene(
            ROBOT,
            (BLOCKS[0], block(Shape.CIRCLE, B, 0.35, 0.6), block(Shape.PENTAGON, G, -0.75, -0.4)),
            region(B, -0.45, 0.55),
        ),
        places=lambda s: {SQUARE: region_centre(s)},
        is_reached=lambda s, points, robot: (
            s.regions[0].contains(*points[SQUARE]) and stayed(s, points, SQUARE)
        ),
        fits=lambda s: all(
            segment_distance(start(s, SQUARE), region_centre(s), start(s, i)) > CLEAR
            for i in range(1, len(s.blocks))
        ),
    ),
    "StopShort": Rule(
        "Push the square in front of the region, but not into it.",
        scene(ROBOT, BLOCKS[:2], region(B, -0.5, 0.35)),
        places=lambda s: {SQUARE: edge_point(s.regions[0], start(s, SQUARE), sum(SHORT) / 2)},
        is_reached=lambda s, points, robot: SHORT[0] < gap(s.regions[0], points[SQUARE]) < SHORT[1],
    ),
    "ThenCircle": Rule(
        "Push the square into the region. Then drive to the circle.",
        scene(ROBOT, BLOCKS[:2], region(Y, 0.6, 0.55)),
        places=lambda s: {SQUARE: region_centre(s)},
        is_reached=lambda s, points, robot: (
            s.regions[0].contains(*points[SQUARE])
            and math.dist(robot, points[CIRCLE]) < ROBOT_NEAR
            and math.dist(points[CIRCLE], start(s, CIRCLE)) < NEAR
        ),
        horizon=140,
        then=CIRCLE,
    ),
}
HELD_BACK = {
    "Swap": Rule(
        "Swap the places of the square and the circle.",
        scene(ROBOT, (BLOCKS[0], block(Shape.CIRCLE, B, -0.4, 0.3))),
        places=lambda s: {SQUARE: start(s, CIRCLE), CIRCLE: start(s, SQUARE)},
        is_reached=lambda s, points, robot: (
            at(start(s, CIRCLE), points[SQUARE]) and at(start(s, SQUARE), points[CIRCLE])
        ),
        fits=lambda s: math.dist(start(s, SQUARE), start(s, CIRCLE)) > 0.6,
        horizon=180,
    ),
    "LeftOf": Rule(
        "Push the square to the left of the region.",
        scene(ROBOT, BLOCKS[:2], region(G, 0.2, 0.45)),
        places=lambda s: {SQUARE: beside(s.regions[0])},
        is_reached=lambda s, points, robot: (
            at(beside(s.regions[0]), points[SQUARE]) and not s.regions[0].contains(*points[SQUARE])
        ),
    ),
    "SmallerRegion": Rule(
        "Push the square into the smaller region.",
        scene(
            ROBOT,
            BLOCKS[:1],
            region(B, -0.5, 0.4, 0.75, 0.75),
            region(B, 0.5, 0.55, 0.52, 0.52),
        ),
        places=lambda s: {SQUARE: smaller(s).centre},
        is_reached=lambda s, points, robot: smaller(s).contains(*points[SQUARE]),
        fits=lambda s: (
            min(r.width * r.height for r in s.regions)
            < 0.75 * max(r.width * r.height for r in s.regions)
        ),
    ),
    "Mirror": Rule(
        "Push the square to the mirror image of its place, left and right exchanged.",
        scene(ROBOT, BLOCKS[:2]),
        places=lambda s: {SQUARE: (-start(s, SQUARE)[0], start(s, SQUARE)[1])},
        is_reached=lambda s, points, robot: at(
            (-start(s, SQUARE)[0], start(s, SQUARE)[1]), points[SQUARE]
        ),
    ),
    "Apart": Rule(
        "Push the square far away from the circle. Do not move the circle.",
        scene(ROBOT, (block(Shape.SQUARE, R, -0.1, -0.1, 0.4), block(Shape.CIRCLE, B, -0.5, 0.3))),
        places=lambda s: {SQUARE: apart(s)},
        is_reached=lambda s, points, robot: (
            math.dist(points[SQUARE], points[CIRCLE]) > APART and stayed(s, points, SQUARE)
        ),
    ),
    "HalfWay": Rule(
        "Push the square half of its way to the region's centre.",
        scene(ROBOT, BLOCKS[:2], region(B, -0.6, 0.3)),
        places=lambda s: {SQUARE: midway(start(s, SQUARE), region_centre(s))},
        is_reached=lambda s, points, robot: at(
            midway(start(s, SQUARE), region_centre(s)), points[SQUARE]
        ),
        fits=lambda s: math.dist(start(s, SQUARE), region_centre(s)) > 0.8,
    ),
}


def make_task(name: str, rule: Rule) -> Task:
    """The task of a rule."""

    def randomise(scene: Scene, axes: Axis, rng: np.random.Generator) -> Scene:
        if Axis.COLOUR not in axes:
            return scene
        blocks = tuple(replace(each, colour=str(rng.choice(COLOURS))) for each in scene.blocks)
        regions = tuple(replace(each, colour=str(rng.choice(COLOURS))) for each in scene.regions)
        return replace(scene, blocks=blocks, regions=regions)

    def score(scene: Scene, poses: Poses) -> float:
        return float(rule.is_reached(scene, positions(scene, poses), tuple(poses.robot[:2])))

    def validate(scene: Scene) -> str:
        if [len(scene.blocks), len(scene.regions)] != counts or not rule.fits(scene):
            return "another scene than the task's"
        places = rule.places(scene)
        if any(max(map(abs, place)) > LIMIT for place in places.values()):
            return "a place too near to the wall"
        starts = [(each.pose.x, each.pose.y) for each in scene.blocks]
        if any(math.dist(place, starts[i]) < 2 * NEAR for i, place in places.items()):
            return "a block that is where it should go"
        if any(
            math.dist(place, starts[j]) < 2 * NEAR
            for place in places.values()
            for j in set(range(len(starts))) - set(places)
        ):
            return "a place taken by another block"
        return ""

    counts = [len(rule.demo.blocks), len(rule.demo.regions)]
    return Task(
        name=name,
        summary=rule.summary,
        horizon=rule.horizon,
        demo=rule.demo,
        axes=AXES,
        randomise_fn=randomise,
        score_fn=score,
        max_blocks=counts[0],
        max_regions=counts[1],
        validate_fn=validate,
    )


def make_planner(rule: Rule) -> Planner:
    """The expert's planner: it brings each block to its place, then the robot to its own."""

    def plan(view: StateView, strategy: Strategy, last: MovePlan) -> MovePlan:
        blocks = list(view.blocks)
        if rule.is_reached(view.scene, blocks, view.position):
            return MovePlan()
        moves = [
            Move(goal, TOLERANCE, i)
            for i, goal in rule.places(view.scene).items()
            if math.dist(blocks[i], goal) > 2 * TOLERANCE
        ]
        if not moves and rule.then is not None:
            return MovePlan((Move(short_of(blocks[rule.then], view.position), 0.05),))
        return MovePlan(tuple(moves))

    return Planner(plan)


def short_of(place: Point, position: Point) -> Point:
    """A point beside a block, on the robot's way to it."""
    share = 0.42 / max(math.dist(place, position), 0.42)
    x, y = (p + share * (q - p) for p, q in zip(place, position, strict=True))
    return x, y


def register() -> None:
    """Register all tasks with their experts, as importing this file does."""
    for name, rule in {**DEVELOPMENT, **HELD_BACK}.items():
        magical.register_task(make_task(name, rule))
        register_planner(name, make_planner(rule))


register()
