"""Perception: finding the objects in frames, with the parser or another function."""

from functools import partial
from typing import Protocol

import numpy as np

from magical.errors import PluginError
from magical.plugins import load_reference
from magical.scene.constants import FRAME_SIZE
from magical_goals.objects.components import Pixels
from magical_goals.objects.parser import ABSENT, ParsedFrames, parse_frames

PARSER = "parser"


class Perception(Protocol):
    """Finds the objects in allocentric frames."""

    def __call__(self, frames: Pixels, robot_alone: bool = False) -> ParsedFrames:
        """Find the objects in frames (B, 96, 96, 3) uint8, as `ParsedFrames` describes them.

        With `robot_alone`, only the robot's pose is needed.
        """


def get_perception(name: str) -> Perception:
    """The parser, or the function that `module:NAME` refers to.

    Raises:
        PluginError: it cannot be imported, is not callable, fails, or returns something else.
    """
    if name == PARSER:
        return parse_frames
    perception: Perception = load_reference(name)
    if not callable(perception):
        raise PluginError(
            f"perception {name!r}: expected a function of frames, found {type(perception).__name__}"
        )
    blank = np.full((1, FRAME_SIZE, FRAME_SIZE, 3), 255, np.uint8)
    try:
        expected, found = parse_frames(blank), perception(blank, robot_alone=True)
    except Exception as error:
        reason = f"{type(error).__name__}: {error}"
        raise PluginError(f"perception {name!r}: fails for a white frame: {reason}") from error
    if not isinstance(found, ParsedFrames) or _layout(found) != _layout(expected):
        raise PluginError(
            f"perception {name!r}: expected ParsedFrames of {_layout(expected)} for one frame, "
            f"found {_layout(found) if isinstance(found, ParsedFrames) else type(found).__name__}"
        )
    return partial(_compacted, perception)


def _compacted(perception: Perception, frames: Pixels, robot_alone: bool = False) -> ParsedFrames:
    """The perceived objects, with the blocks in the first slots, as the parser returns them."""
    parsed = perception(frames, robot_alone=robot_alone)
    order = np.argsort(parsed.colours == ABSENT, axis=1, kind="stable")
    return parsed._replace(
        blocks=np.take_along_axis(parsed.blocks, order[:, :, None], axis=1),
        colours=np.take_along_axis(parsed.colours, order, axis=1),
        shapes=np.take_along_axis(parsed.shapes, order, axis=1),
    )


def _layout(parsed: ParsedFrames) -> str:
    """The type and shape of each array."""
    return ", ".join(f"{column.dtype} {column.shape}" for column in parsed)
