"""The number, colours and shapes of blocks: sampled (docs/specification.md, section 8), named."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from magical.scene import COLOURS, SHAPES, Block
from magical.tasks.axes import Axis

Item = TypeVar("Item")

NUMBERS = {2: "both", 3: "the three", 4: "the four", 5: "the five", 6: "the six"}


def name_blocks(blocks: Sequence[Block]) -> str:
    """The blocks in English, such as "the red star, the red circle and both blue stars"."""
    kinds = Counter(f"{block.colour} {block.shape}" for block in blocks)
    *names, last = (
        f"the {kind}" if count == 1 else f"{NUMBERS.get(count, f'the {count}')} {kind}s"
        for kind, count in kinds.items()
    )
    return f"{', '.join(names)} and {last}" if names else last


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
