"""Perception: what finds the objects of frames, the parser or a function of others."""

from functools import partial
from typing import Protocol

import numpy as np

from magical.errors import PluginError
from magical.learning.objects.components import Pixels
from magical.learning.objects.parser import ABSENT, ParsedFrames, parse_frames
from magical.plugins import load_plugin
from magical.scene.constants import FRAME_SIZE

PARSER = "parser"
PERCEPTIONS = "magical.perceptions"  # the group of entry points


class Perception(Protocol):
    """Finds the objects of allocentric frames."""

    def __call__(self, frames: Pixels, robot_alone: bool = False) -> ParsedFrames:
        """Find the objects of frames (B, 96, 96, 3) uint8, as `ParsedFrames` describes them.

        With `robot_alone` the robot's pose is enough.
        """


def get_perception(name: str) -> Perception:
    """The parser, or what an entry point or `module:NAME` stands for.

    Raises:
        PluginError: it cannot be imported, is no function, or returns something else.
    """
    if name == PARSER:
        return parse_frames
    perception: Perception = load_plugin(PERCEPTIONS, name)
    if not callable(perception):
        raise PluginError(
            f"perception {name!r}: expected a function of frames, found {type(perception).__name__}"
        )
    blank = np.full((1, FRAME_SIZE, FRAME_SIZE, 3), 255, np.uint8)
    expected, found = parse_frames(blank), perception(blank, robot_alone=True)
    if not isinstance(found, ParsedFrames) or _layout(found) != _layout(expected):
        raise PluginError(
            f"perception {name!r}: expected ParsedFrames of {_layout(expected)} for one frame, "
            f"found {_layout(found) if isinstance(found, ParsedFrames) else type(found).__name__}"
        )
    return partial(_compacted, perception)


def _compacted(perception: Perception, frames: Pixels, robot_alone: bool = False) -> ParsedFrames:
    """What is perceived, with the blocks that are there in the first slots, as from the parser."""
    parsed = perception(frames, robot_alone=robot_alone)
    order = np.argsort(parsed.colours == ABSENT, axis=1, kind="stable")
    return parsed._replace(
        blocks=np.take_along_axis(parsed.blocks, order[:, :, None], axis=1),
        colours=np.take_along_axis(parsed.colours, order, axis=1),
        shapes=np.take_along_axis(parsed.shapes, order, axis=1),
    )


def _layout(parsed: ParsedFrames) -> str:
    """Type and shape of each array."""
    return ", ".join(f"{column.dtype} {column.shape}" for column in parsed)
