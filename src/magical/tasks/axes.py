"""What a test variant changes, as a set of axes (appendix, Table 2)."""

from collections.abc import Mapping
from enum import Flag, auto

from magical.errors import UnknownNameError


class Axis(Flag):
    """One way in which a variant's scenes differ from the Demo scene.

    Source: docs/specification.md, section 8.
    """

    JITTER = auto()
    LAYOUT = auto()
    COLOUR = auto()
    SHAPE = auto()
    COUNT = auto()
    DYNAMICS = auto()


CHANGES: Mapping[Axis, str] = {
    Axis.JITTER: "small changes of poses and region sizes",
    Axis.LAYOUT: "poses anywhere in the workspace, region sizes in their whole range",
    Axis.COLOUR: "colours of blocks and regions",
    Axis.SHAPE: "shapes of blocks",
    Axis.COUNT: "number of blocks; only together with layout, colour and shape",
    Axis.DYNAMICS: "friction and motor forces",  # docs/specification.md, section 5
}

EVERYTHING = ~Axis(0)
DEMO = "Demo"
TEST_ALL = "TestAll"

# By the names used in environment ids. `TestAll` has the axes for a task that supports all of them;
# see `Task.axes_of` for other tasks.
VARIANTS: Mapping[str, Axis] = {
    DEMO: Axis(0),
    "TestJitter": Axis.JITTER,
    "TestLayout": Axis.LAYOUT,
    "TestColour": Axis.COLOUR,
    "TestShape": Axis.SHAPE,
    "TestCountPlus": Axis.LAYOUT | Axis.COLOUR | Axis.SHAPE | Axis.COUNT,
    "TestDynamics": Axis.DYNAMICS,
    TEST_ALL: EVERYTHING & ~Axis.JITTER,
}


# What differs from the Demo scene in each variant, in words.
CHANGED: Mapping[str, str] = {
    DEMO: "nothing: the scene of the demonstrations",
    **{name: CHANGES[axes] for name, axes in VARIANTS.items() if axes in CHANGES},
    "TestCountPlus": CHANGES[Axis.COUNT],
    TEST_ALL: "all that the task allows, together",
}


def short_variant(variant: str) -> str:
    """A variant's name in tables, for instance `Jitter` for `TestJitter`."""
    return variant.removeprefix("Test")


SHORT_VARIANTS = tuple(map(short_variant, VARIANTS))  # Demo, Jitter, Layout, ...


def full_variant(variant: str) -> str:
    """A variant's full name, from its short or full name; raises `UnknownNameError`."""
    for name in VARIANTS:
        if variant in (name, short_variant(name)):
            return name
    raise UnknownNameError(
        f"{variant!r} is not a variant; expected some of: {', '.join(SHORT_VARIANTS)}"
    )
