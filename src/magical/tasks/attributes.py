"""Drawing what blocks are: their number, colours and shapes (docs/specification.md, section 8)."""

from collections.abc import Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from magical.scene import COLOURS, SHAPES, Block
from magical.tasks.axes import Axis

Item = TypeVar("Item")


def sample_item(items: Sequence[Item], rng: np.random.Generator) -> Item:
    """One of the items, uniformly."""
    return items[int(rng.integers(len(items)))]


def sample_count(least: int, most: int, rng: np.random.Generator) -> int:
    """A whole number from `least` to `most`, uniformly."""
    return int(rng.integers(least, most + 1))


def sample_covering(items: Sequence[Item], count: int, rng: np.random.Generator) -> list[Item]:
    """`count` items in random order: each item once, the rest uniform."""
    drawn = [*items, *(sample_item(items, rng) for _ in range(count - len(items)))]
    return [drawn[i] for i in rng.permutation(count)]


def take(blocks: Sequence[Block], count: int) -> tuple[Block, ...]:
    """`count` blocks, repeated where there are too few.

    Only for a COUNT variant, which then draws every pose, colour and shape anew.
    """
    return tuple(blocks[i % len(blocks)] for i in range(count))


def repaint(blocks: Sequence[Block], axes: Axis, rng: np.random.Generator) -> tuple[Block, ...]:
    """The blocks, each with its own uniform colour (COLOUR) and shape (SHAPE)."""
    return tuple(
        replace(
            block,
            colour=sample_item(COLOURS, rng) if Axis.COLOUR in axes else block.colour,
            shape=sample_item(SHAPES, rng) if Axis.SHAPE in axes else block.shape,
        )
        for block in blocks
    )
