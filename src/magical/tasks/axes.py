"""What a test variant changes, as a set of axes (appendix, Table 2), and sampling along the axes.

Source: docs/specification.md, section 8. `placement` samples along JITTER and LAYOUT.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from enum import Flag, auto
from typing import TypeVar

import numpy as np

from magical.errors import UnknownNameError
from magical.scene import COLOURS, SHAPES, Block

Item = TypeVar("Item")


class Axis(Flag):
    """One way in which a variant's scenes differ from the Demo scene."""

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

# By the names used in environment ids. `Task.axes_of` has a task's own axes of TestAll.
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


def sample_item(items: Sequence[Item], rng: np.random.Generator) -> Item:
    """Sample one of the items uniformly."""
    return items[int(rng.integers(len(items)))]


def sample_count(least: int, most: int, rng: np.random.Generator) -> int:
    """Sample an integer uniformly from `least` to `most`, inclusive."""
    return int(rng.integers(least, most + 1))


def sample_covering(items: Sequence[Item], count: int, rng: np.random.Generator) -> list[Item]:
    """Sample `count` items in random order: each item at least once, the rest uniform."""
    sampled = [*items, *(sample_item(items, rng) for _ in range(count - len(items)))]
    return [sampled[i] for i in rng.permutation(count)]


def cycle_blocks(blocks: Sequence[Block], count: int) -> tuple[Block, ...]:
    """The first `count` blocks, starting over if there are too few.

    Only for variants with COUNT, which sample every pose, colour and shape afterwards.
    """
    return tuple(blocks[i % len(blocks)] for i in range(count))


def sample_attributes(
    blocks: Sequence[Block], axes: Axis, rng: np.random.Generator
) -> tuple[Block, ...]:
    """The blocks with independent, uniform colours (COLOUR) and shapes (SHAPE)."""
    return tuple(
        replace(
            block,
            colour=sample_item(COLOURS, rng) if Axis.COLOUR in axes else block.colour,
            shape=sample_item(SHAPES, rng) if Axis.SHAPE in axes else block.shape,
        )
        for block in blocks
    )


def name_blocks(blocks: Sequence[Block]) -> str:
    """The blocks in English, such as "the red star, the red circle and both blue stars"."""
    numbers = {2: "both", 3: "the three", 4: "the four", 5: "the five", 6: "the six"}
    kinds = Counter(f"{block.colour} {block.shape}" for block in blocks)
    *names, last = (
        f"the {kind}" if count == 1 else f"{numbers.get(count, f'the {count}')} {kind}s"
        for kind, count in kinds.items()
    )
    return f"{', '.join(names)} and {last}" if names else last
