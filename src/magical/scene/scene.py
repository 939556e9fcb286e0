"""Poses, blocks, goal regions, scenes and dynamics, as plain frozen data."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any, NamedTuple

import numpy as np

from magical.errors import InvalidSceneError
from magical.messages import quoted
from magical.scene.constants import MAX_BLOCKS, MAX_COORDINATE, MAX_REGIONS
from magical.scene.vocabulary import Colour, Shape, parse_word

_NUMBERS = (float, int, np.floating, np.integer)


class Pose(NamedTuple):
    """A position in workspace units and an angle in radians, counter-clockwise."""

    x: float
    y: float
    angle: float


def _floats(what: str, values: Sequence[Any], count: int) -> list[float]:
    """`count` finite numbers, including NumPy's, as floats; raises `InvalidSceneError`."""
    try:
        numbers = [float(value) for value in values if isinstance(value, _NUMBERS)]
        if len(values) == len(numbers) == count and all(map(math.isfinite, numbers)):
            return numbers
    except (TypeError, OverflowError):  # not a sequence, or an integer too large for a float
        pass
    raise InvalidSceneError(f"{what}: expected {count} finite numbers, found {quoted(values)}")


def _pose(what: str, values: Sequence[Any]) -> Pose:
    return Pose(*_floats(f"{what} (x, y, angle)", values, 3))


@dataclass(frozen=True, slots=True)
class Block:
    """A movable block.

    Raises:
        UnknownNameError: no such shape or colour.
        InvalidSceneError: the pose is not three finite numbers.
    """

    shape: Shape
    colour: Colour
    pose: Pose

    def __post_init__(self) -> None:
        object.__setattr__(self, "shape", parse_word(Shape, self.shape))
        object.__setattr__(self, "colour", parse_word(Colour, self.colour))
        object.__setattr__(self, "pose", _pose(f"{self.colour} {self.shape}", self.pose))


@dataclass(frozen=True, slots=True)
class Region:
    """A goal region: an axis-aligned rectangle with left `x` and top `y`.

    Source: docs/specification.md, section 4.

    Raises:
        UnknownNameError: no such colour.
        InvalidSceneError: coordinates that are not finite, or a size that is not positive.
    """

    colour: Colour
    x: float  # workspace units, like the others
    y: float
    height: float
    width: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "colour", parse_word(Colour, self.colour))
        values = _floats(f"{self.colour} region", (self.x, self.y, self.height, self.width), 4)
        for name, value in zip(("x", "y", "height", "width"), values, strict=True):
            object.__setattr__(self, name, value)
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
        names = [field.name for field in fields(self)]
        values = _floats("dynamics", [getattr(self, name) for name in names], len(names))
        for name, value in zip(names, values, strict=True):
            object.__setattr__(self, name, value)
        if min(values) <= 0:
            raise InvalidSceneError(f"dynamics: expected positive forces, found {values}")

    @staticmethod
    def sample(rng: np.random.Generator) -> "Dynamics":
        """A uniform sample from `DYNAMICS_RANGES`."""
        return Dynamics(*(float(rng.uniform(low, high)) for low, high in DYNAMICS_RANGES))

    @staticmethod
    def from_dict(data: Mapping[str, Any] | Sequence[float]) -> "Dynamics":
        """The inverse of `to_dict`; also takes only some fields, or all five numbers in order.

        Raises:
            InvalidSceneError: anything else, or forces that are not positive.
        """
        names = [field.name for field in fields(Dynamics)]
        if not isinstance(data, Mapping):
            data = dict(zip(names, _floats("dynamics", data, len(names)), strict=True))
        if not set(data) <= set(names):
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
        InvalidSceneError: the robot's pose is not three finite numbers, there are more than
            `MAX_BLOCKS` blocks or `MAX_REGIONS` regions, or a number is beyond `MAX_COORDINATE`.
    """

    robot: Pose
    blocks: tuple[Block, ...] = ()
    regions: tuple[Region, ...] = ()
    robot_first: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "robot", _pose("robot", self.robot))
        object.__setattr__(self, "blocks", tuple(self.blocks))
        object.__setattr__(self, "regions", tuple(self.regions))
        if len(self.blocks) > MAX_BLOCKS or len(self.regions) > MAX_REGIONS:
            raise InvalidSceneError(
                f"scene: expected at most {MAX_BLOCKS} blocks and {MAX_REGIONS} regions, "
                f"found {len(self.blocks)} and {len(self.regions)}"
            )
        poses = [self.robot, *(block.pose for block in self.blocks)]
        areas = [(r.x, r.y, r.height, r.width) for r in self.regions]
        furthest = max(abs(number) for numbers in (*poses, *areas) for number in numbers)
        if furthest > MAX_COORDINATE:
            raise InvalidSceneError(
                f"scene: expected numbers up to {MAX_COORDINATE:g}, found {furthest:g}"
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
                regions=tuple(map(_region, given.pop("regions", ()))),
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


def _region(data: Mapping[str, Any] | Sequence[Any]) -> Region:
    return Region(**data) if isinstance(data, Mapping) else Region.from_centre(*data)
