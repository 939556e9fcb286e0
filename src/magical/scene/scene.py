"""The vocabulary of scenes, and scenes as plain frozen data (docs/specification.md, 3 to 6)."""

import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, fields
from enum import StrEnum
from typing import Any, NamedTuple, TypeVar

import numpy as np

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


def _pose(what: str, values: Sequence[Any]) -> Pose:
    return Pose(*_floats(f"{what} (x, y, angle)", values, 3))


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
        object.__setattr__(self, "pose", _pose(f"{self.colour} {self.shape}", self.pose))


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
        """The inverse of `to_dict`; takes only some fields too.

        Raises:
            InvalidSceneError: anything else, or forces that are not positive.
        """
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
        object.__setattr__(self, "robot", _pose("robot", self.robot))
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
    numbers = isinstance(size, int) and samples in (None, *c.SAMPLES)
    if numbers and bool not in (type(size), type(samples)) and 0 < size <= c.MAX_FRAME_SIZE:
        chosen = default_samples(size) if samples is None else int(samples)  # no kernel takes float
        if size * chosen <= c.MAX_SAMPLES_ACROSS:
            return chosen
    raise RenderError(
        f"expected a size from 1 to {c.MAX_FRAME_SIZE} and samples among {c.SAMPLES}, together at "
        f"most {c.MAX_SAMPLES_ACROSS} across a frame, found {quoted(size)} and {quoted(samples)}"
    )
