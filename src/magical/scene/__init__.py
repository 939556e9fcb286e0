"""Scenes as plain frozen data, actions and poses. Nothing here is simulated, rendered or scored.

Sources: docs/specification.md, sections 1 to 6 and 8.
"""

import math
import sys
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, fields
from enum import IntEnum, StrEnum
from functools import cache
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from magical.errors import InvalidSceneError, RenderError, UnknownNameError
from magical.messages import quoted
from magical.scene import constants as c

_NUMBERS = (float, int, np.floating, np.integer)


class Shape(StrEnum):
    """A block's shape."""

    SQUARE = "square"
    CIRCLE = "circle"
    PENTAGON = "pentagon"
    STAR = "star"


class Colour(StrEnum):
    """A block's or goal region's colour."""

    RED = "red"
    GREEN = "green"
    BLUE = "blue"
    YELLOW = "yellow"


class View(StrEnum):
    """A camera: robot-centred (egocentric) or fixed (allocentric); appendix A.1."""

    EGO = "ego"
    ALLO = "allo"


SHAPES = tuple(Shape)
COLOURS = tuple(Colour)

Word = TypeVar("Word", bound=StrEnum)


def parse_word(kind: type[Word], value: Any) -> Word:
    """Return the member of `kind` spelt `value`; raise `UnknownNameError` listing the members."""
    try:
        return kind(value)
    except ValueError:
        known = ", ".join(kind)
        raise UnknownNameError(
            f"{quoted(value)} is not a {kind.__name__.lower()}; expected one of: {known}"
        ) from None


class Pose(NamedTuple):
    """A position in workspace units and an angle in radians, counter-clockwise."""

    x: float
    y: float
    angle: float


def _floats(
    what: str, values: Sequence[Any], count: int, limit: float = c.MAX_COORDINATE
) -> list[float]:
    """`count` numbers, including NumPy's, as floats; raises `InvalidSceneError`."""
    with suppress(TypeError, OverflowError):  # no sequence, or an integer too large for a float
        numbers = [float(value) for value in values if isinstance(value, _NUMBERS)]
        valid = all(abs(number) <= limit for number in numbers)  # false for NaN
        if valid and len(values) == len(numbers) == count:
            return numbers
    raise InvalidSceneError(
        f"{what}: expected {count} finite numbers up to {limit:g}, found {quoted(values)}"
    )


def _set_floats(record: Any, what: str, limit: float = c.MAX_COORDINATE) -> list[float]:
    """Make floats of a record's fields but its colour; raises `InvalidSceneError`."""
    names = [field.name for field in fields(record) if field.name != "colour"]
    values = _floats(what, [getattr(record, name) for name in names], len(names), limit)
    for name, value in zip(names, values, strict=True):
        object.__setattr__(record, name, value)
    return values


@dataclass(frozen=True, slots=True)
class Block:
    """A movable block.

    Raises:
        UnknownNameError: no such shape or colour.
        InvalidSceneError: the pose is not three numbers up to `MAX_COORDINATE`.
    """

    shape: Shape
    colour: Colour
    pose: Pose

    def __post_init__(self) -> None:
        object.__setattr__(self, "shape", parse_word(Shape, self.shape))
        object.__setattr__(self, "colour", parse_word(Colour, self.colour))
        what = f"{self.colour} {self.shape} (x, y, angle)"
        object.__setattr__(self, "pose", Pose(*_floats(what, self.pose, 3)))


@dataclass(frozen=True, slots=True)
class Region:
    """A goal region: an axis-aligned rectangle with left `x` and top `y`.

    Source: docs/specification.md, section 4.

    Raises:
        UnknownNameError: no such colour.
        InvalidSceneError: numbers beyond `MAX_COORDINATE`, or a size that is not positive.
    """

    colour: Colour
    x: float  # workspace units, like the others
    y: float
    height: float
    width: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "colour", parse_word(Colour, self.colour))
        _set_floats(self, f"{self.colour} region")
        if self.height <= 0 or self.width <= 0:
            raise InvalidSceneError(
                f"{self.colour} region: expected positive height and width, "
                f"found {self.height} x {self.width}"
            )

    @property
    def centre(self) -> tuple[float, float]:
        """The rectangle's centre (x, y)."""
        return self.x + self.width / 2, self.y - self.height / 2

    def contains(self, x: float, y: float) -> bool:
        """Whether the point lies inside, edges included (docs/specification.md, section 4)."""
        return self.x <= x <= self.x + self.width and self.y - self.height <= y <= self.y

    @staticmethod
    def from_centre(colour: str, x: float, y: float, height: float, width: float) -> "Region":
        """The region with its centre at (x, y)."""
        return Region(parse_word(Colour, colour), x - width / 2, y + height / 2, height, width)


@dataclass(frozen=True, slots=True)
class Dynamics:
    """The five parameters sampled by the Dynamics variant (docs/specification.md, section 5)."""

    body_pivot_max_force: float = 3.0
    body_gear_max_force: float = 1.0
    finger_motor_max_force: float = 4.0
    block_pivot_max_force: float = 1.5
    block_gear_max_force: float = 0.1

    def __post_init__(self) -> None:
        forces = _set_floats(self, "dynamics", sys.float_info.max)
        if min(forces) <= 0:
            raise InvalidSceneError(f"dynamics: expected positive forces, found {forces}")

    @staticmethod
    def sample(rng: np.random.Generator) -> "Dynamics":
        """A uniform sample from `DYNAMICS_RANGES`."""
        return Dynamics(*(float(rng.uniform(low, high)) for low, high in DYNAMICS_RANGES))

    @staticmethod
    def from_dict(data: Mapping[str, Any]) -> "Dynamics":
        """The inverse of `to_dict`; takes only some fields too. Raises `InvalidSceneError`."""
        names = [field.name for field in fields(Dynamics)]
        if not isinstance(data, Mapping) or not set(data) <= set(names):
            raise InvalidSceneError(f"dynamics: expected some of {names}, found {quoted(data)}")
        return Dynamics(**data)

    def to_dict(self) -> dict[str, float]:
        """Plain data for JSON."""
        return asdict(self)


# (low, high) of each field of `Dynamics`, in order (docs/specification.md, section 5).
DYNAMICS_RANGES = ((2.2, 3.5), (0.7, 1.5), (2.5, 4.5), (1.0, 1.8), (0.07, 0.15))


@dataclass(frozen=True, slots=True)
class Scene:
    """An initial scene at rest: robot with open fingers, blocks, goal regions.

    Bodies are created and rendered in the order regions, blocks, robot; with `robot_first` the
    robot comes before (under) the blocks, as in MoveToCorner (docs/specification.md, section 6).

    Raises:
        InvalidSceneError: the robot's pose is not three numbers up to `MAX_COORDINATE`, or there
            are more than `MAX_BLOCKS` blocks or `MAX_REGIONS` regions.
    """

    robot: Pose
    blocks: tuple[Block, ...] = ()
    regions: tuple[Region, ...] = ()
    robot_first: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "robot", Pose(*_floats("robot (x, y, angle)", self.robot, 3)))
        object.__setattr__(self, "blocks", tuple(self.blocks))
        object.__setattr__(self, "regions", tuple(self.regions))
        if len(self.blocks) > c.MAX_BLOCKS or len(self.regions) > c.MAX_REGIONS:
            raise InvalidSceneError(
                f"scene: expected at most {c.MAX_BLOCKS} blocks and {c.MAX_REGIONS} regions, "
                f"found {len(self.blocks)} and {len(self.regions)}"
            )

    def to_dict(self) -> dict[str, Any]:
        """Plain data for JSON, from which `from_dict` makes an equal scene.

        `robot` [x, y, angle]; `blocks` [[shape, colour, x, y, angle], ...]; `regions`
        [{colour, x, y, height, width}, ...]; `robot_first`.
        """
        return {
            "robot": list(self.robot),
            "blocks": [[str(b.shape), str(b.colour), *b.pose] for b in self.blocks],
            "regions": [{**asdict(r), "colour": str(r.colour)} for r in self.regions],
            "robot_first": self.robot_first,
        }

    @staticmethod
    def from_dict(data: Mapping[str, Any]) -> "Scene":
        """The inverse of `to_dict`.

        Regions may also be [colour, centre x, centre y, height, width], as in the recordings.

        Raises `InvalidSceneError` or `UnknownNameError`.
        """
        try:
            given = {**data}
            scene = Scene(
                robot=given.pop("robot"),
                blocks=tuple(Block(b[0], b[1], b[2:]) for b in given.pop("blocks", ())),
                regions=tuple(
                    Region(**r) if isinstance(r, Mapping) else Region.from_centre(*r)
                    for r in given.pop("regions", ())
                ),
                robot_first=given.pop("robot_first", False),
            )
            if given or not isinstance(scene.robot_first, bool):
                raise TypeError("another field, or robot_first of another type")
            return scene
        except (KeyError, IndexError, TypeError, OverflowError) as error:
            raise InvalidSceneError(
                "scene: expected robot [x, y, angle], blocks [[shape, colour, x, y, angle], ...], "
                "regions [{colour, x, y, height, width}, ...] or [[colour, centre x, centre y, "
                f"height, width], ...], robot_first true or false; found {quoted(data)}"
            ) from error


def default_samples(size: int) -> int:
    """Samples across a pixel: the fewest that make at least 384 across a frame, at most 4."""
    return next((n for n in c.SAMPLES if n * size >= c.RAW_FRAME_SIZE), max(c.SAMPLES))


def chosen_samples(size: int, samples: int | None) -> int:
    """The samples across a pixel, `default_samples` for None; raises `RenderError`."""
    numbers = isinstance(size, int) and size > 0 and samples in (None, *c.SAMPLES)
    if numbers and bool not in (type(size), type(samples)):
        chosen = default_samples(size) if samples is None else int(samples)  # no kernel takes float
        if size * chosen <= c.MAX_SAMPLES_ACROSS:
            return chosen
    raise RenderError(
        f"expected a positive size and samples among {c.SAMPLES}, together at most "
        f"{c.MAX_SAMPLES_ACROSS} across a frame, found {quoted(size)} and {quoted(samples)}"
    )


class Longitudinal(IntEnum):
    """Driving along the robot's own y axis."""

    STOP = 0
    FORWARD = 1
    BACK = 2


class Turn(IntEnum):
    """Turning on the spot; left is counter-clockwise."""

    STRAIGHT = 0
    LEFT = 1
    RIGHT = 2


class Gripper(IntEnum):
    """Opening or closing the fingers."""

    OPEN = 0
    CLOSED = 1


class Action(NamedTuple):
    """One discrete action by its three components (appendix A.1).

    The first, stop, straight and open, is the no-op.
    """

    longitudinal: Longitudinal = Longitudinal.STOP
    turn: Turn = Turn.STRAIGHT
    gripper: Gripper = Gripper.OPEN

    @property
    def id(self) -> int:
        """The action's number, 0 to 17."""
        return self.longitudinal + 3 * self.turn + 9 * self.gripper

    @property
    def name(self) -> str:
        """The action's name, such as `forward-left-closed`."""
        return f"{self.longitudinal.name}-{self.turn.name}-{self.gripper.name}".lower()


ACTIONS = tuple(
    Action(lon, turn, grip) for grip in Gripper for turn in Turn for lon in Longitudinal
)
ACTION_NAMES = tuple(action.name for action in ACTIONS)
NUM_ACTIONS = len(ACTIONS)
NOOP = Action().id
# The number of each action with left and right exchanged.
MIRRORED_ACTIONS = tuple(a._replace(turn=Turn(-a.turn % len(Turn))).id for a in ACTIONS)

# A continuous action is a point (drive, turn, grip), each from -1 to 1: back to forward, right to
# left, open to closed. `POINTS` has the discrete actions as such.
PARTS = ("drive", "turn", "grip")
_SIGNS, _GRIPS = (0.0, 1.0, -1.0), (-1.0, 1.0)
POINTS = tuple((_SIGNS[a.longitudinal], _SIGNS[a.turn], _GRIPS[a.gripper]) for a in ACTIONS)
_POINTS = np.array(POINTS)


def to_continuous(actions: ArrayLike) -> NDArray[np.float64]:
    """Discrete actions (...,) as continuous ones (..., 3), which produce the same motions."""
    return _POINTS[np.asarray(actions, np.intp)]


def to_discrete(actions: ArrayLike) -> NDArray[np.int64]:
    """The inverse of `to_continuous`; raises `ValueError` for a point that is not one of the 18."""
    points = np.asarray(actions, np.float64).reshape(*np.shape(actions)[:-1], len(PARTS))
    equal = (points[..., None, :] == POINTS).all(axis=-1)  # (..., 18)
    others = points[~equal.any(axis=-1)]
    if len(others):
        raise ValueError(
            f"expected points of the {NUM_ACTIONS} discrete actions, of -1, 0 and 1 (grip: -1 and "
            f"1), found {others[0].tolist()}; {len(others)} of {equal[..., 0].size} are not"
        )
    numbers: NDArray[np.int64] = equal.argmax(axis=-1)
    return numbers


Point = tuple[float, float]
Polygon = tuple[Point, ...]


def rotate(point: Point, angle: float) -> Point:
    """The point rotated about the origin, counter-clockwise."""
    cos, sin = math.cos(angle), math.sin(angle)
    return cos * point[0] - sin * point[1], sin * point[0] + cos * point[1]


def to_workspace(point: Point, pose: Pose) -> Point:
    """A point given in a body's frame, in workspace coordinates."""
    x, y = rotate(point, pose.angle)
    return pose.x + x, pose.y + y


def lengths(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Lengths (...) of vectors (..., 2)."""
    return np.sqrt(vectors[..., 0] ** 2 + vectors[..., 1] ** 2)


def rectangle(width: float, height: float) -> Polygon:
    """A rectangle about the origin, counter-clockwise from its top right corner."""
    x, y = width / 2, height / 2
    return (x, y), (-x, y), (-x, -y), (x, -y)


def regular_polygon(count: int, radius: float) -> Polygon:
    """`count` vertices on a circle, counter-clockwise, the first straight up."""
    return tuple(rotate((0.0, radius), 2 * math.pi * i / count) for i in range(count))


def star_polygon(outer: float, inner: float) -> Polygon:
    """A five-pointed star, counter-clockwise, the first outer vertex straight up."""
    return tuple(rotate((0.0, inner if i % 2 else outer), math.pi * i / 5) for i in range(10))


def shift(polygon: Iterable[Point], dx: float, dy: float) -> Polygon:
    """The polygon translated by (dx, dy)."""
    return tuple((x + dx, y + dy) for x, y in polygon)


@cache
def finger_polygons(side: int, shrink: float = 0.0) -> tuple[Polygon, Polygon]:
    """Upper arm and forearm of a finger in its own frame, their dimensions reduced by `shrink`."""
    thickness = c.FINGER_THICKNESS - shrink
    upper_length, fore_length = c.UPPER_ARM_LENGTH - shrink, c.FOREARM_LENGTH - shrink
    upper = shift(rectangle(thickness, upper_length), 0.0, upper_length / 2)
    bend = side * c.FOREARM_BEND
    turned = [rotate(vertex, bend) for vertex in rectangle(thickness, fore_length)]
    elbow_x, elbow_y = rotate((-side * thickness / 2, fore_length / 2), bend)
    # Summed in the order of docs/specification.md, section 2: the last bit matters for gripping.
    centre_x, centre_y = side * thickness / 2 + elbow_x, upper_length / 2 + elbow_y
    return upper, shift(turned, centre_x, centre_y + upper_length / 2)


@cache
def block_outline(shape: Shape) -> Polygon:
    """The polygon of a block in its own frame; of a circle, ()."""
    if shape == Shape.SQUARE:
        return rectangle(c.SQUARE_SIDE, c.SQUARE_SIDE)
    if shape == Shape.PENTAGON:
        return regular_polygon(5, c.PENTAGON_RADIUS)
    if shape == Shape.STAR:
        return star_polygon(c.STAR_OUTER_RADIUS, c.STAR_INNER_RADIUS)
    return ()


@cache
def robot_polygons() -> tuple[Polygon, ...]:
    """The polygons of both open fingers in the robot's frame."""
    return tuple(
        tuple(to_workspace(vertex, root) for vertex in polygon)
        for side in c.SIDES
        for root in [Pose(side * c.FINGER_ROOT_X, c.FINGER_ROOT_Y, -side * c.FINGER_OPEN)]
        for polygon in finger_polygons(side)
    )


# Rows of bodies: the robot, fingers and eyes (each left and right), and the scene's first block.
ROBOT, FINGERS, EYES, FIRST_BLOCK = 0, slice(1, 3), slice(3, 5), 5


@dataclass(frozen=True, slots=True)
class Poses:
    """The pose (x, y, angle) of every body, in the rows named above.

    A finger's position is that of its root; its angle is that of its own frame in the workspace
    (an open left finger is at the robot's angle + pi/8). An eye's angle turns its pupil; its
    position is the robot's.
    """

    bodies: NDArray[np.float64]  # (5 + number of blocks, 3)

    @property
    def robot(self) -> Pose:
        """The robot's pose."""
        return Pose(*self.bodies[ROBOT].tolist())

    @property
    def blocks(self) -> NDArray[np.float64]:
        """The blocks' poses in the scene's order, (number of blocks, 3)."""
        return self.bodies[FIRST_BLOCK:]

    @property
    def finger_angles(self) -> NDArray[np.float64]:
        """The fingers' angles in the workspace, left and right, (2,) radians."""
        return self.bodies[FINGERS, 2]

    @staticmethod
    def at_rest(scene: Scene) -> "Poses":
        """A scene's initial poses: fingers fully open, eyes straight ahead."""
        robot = scene.robot
        fingers = [
            (*to_workspace((side * c.FINGER_ROOT_X, c.FINGER_ROOT_Y), robot), turn)
            for side in c.SIDES
            for turn in [robot.angle - side * c.FINGER_OPEN]
        ]
        rows = [robot, *fingers, robot, robot, *(block.pose for block in scene.blocks)]
        return Poses(np.array(rows, dtype=np.float64))


@dataclass(frozen=True, slots=True)
class State:
    """The true state of an environment: a scene, its bodies' motion, and the time left.

    Scripted experts and privileged learners observe it.
    """

    scene: Scene
    poses: Poses
    velocities: NDArray[np.float64]  # (5 + number of blocks, 3): x, y, angular, per second
    step: int  # control steps since reset
    horizon: int  # control steps in the episode

    @property
    def bodies(self) -> NDArray[np.float64]:
        """Poses and velocities, (5 + number of blocks, 6)."""
        return np.hstack([self.poses.bodies, self.velocities])
