"""The vocabulary of scenes: shapes, colours, views (docs/specification.md, sections 3 and 6)."""

from enum import StrEnum
from typing import Any, TypeVar

from magical.errors import UnknownNameError
from magical.messages import quoted


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


class Corner(StrEnum):
    """A corner of the workspace."""

    TOP_LEFT = "top left"
    TOP_RIGHT = "top right"
    BOTTOM_LEFT = "bottom left"
    BOTTOM_RIGHT = "bottom right"


class Wall(StrEnum):
    """A wall of the workspace."""

    LEFT = "left"
    RIGHT = "right"
    TOP = "top"
    BOTTOM = "bottom"


class Landmark(StrEnum):
    """What a block can be near to or far from."""

    REGION = "region"  # the nearest one
    ROBOT = "robot"  # where it starts
    CENTRE = "centre"  # of the workspace


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
