"""The vocabulary of scenes: shapes, colours, views (docs/specification.md, sections 3 and 6)."""

from enum import StrEnum
from typing import Any, TypeVar

from magical.errors import RenderError, UnknownNameError
from magical.messages import quoted
from magical.scene.constants import MAX_FRAME_SIZE, MAX_SAMPLES_ACROSS, RAW_FRAME_SIZE, SAMPLES


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


def default_samples(size: int) -> int:
    """Samples across a pixel: the fewest that make at least 384 across a frame, at most 4."""
    return next((n for n in SAMPLES if n * size >= RAW_FRAME_SIZE), max(SAMPLES))


def chosen_samples(size: int, samples: int | None) -> int:
    """The samples across a pixel, `default_samples` for None; raises `RenderError`."""
    if isinstance(size, int) and 0 < size <= MAX_FRAME_SIZE and samples in (None, *SAMPLES):
        chosen = default_samples(size) if samples is None else int(samples)  # no kernel takes float
        if size * chosen <= MAX_SAMPLES_ACROSS:
            return chosen
    raise RenderError(
        f"expected a size from 1 to {MAX_FRAME_SIZE} and samples among {SAMPLES}, together at "
        f"most {MAX_SAMPLES_ACROSS} across a frame, found {quoted(size)} and {quoted(samples)}"
    )
