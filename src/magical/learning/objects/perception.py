"""Perception: what finds the objects of frames, the parser or a function of others."""

from typing import Protocol

from magical.errors import PluginError
from magical.learning.objects.components import Pixels
from magical.learning.objects.parser import ParsedFrames, parse_frames
from magical.plugins import load_plugin

PARSER = "parser"
PERCEPTIONS = "magical.perceptions"  # the group of entry points


class Perception(Protocol):
    """Finds the objects of allocentric frames."""

    def __call__(self, frames: Pixels, robot_alone: bool = False) -> ParsedFrames:
        """Find the objects of frames (B, 96, 96, 3); with `robot_alone`, its pose is enough."""


def get_perception(name: str) -> Perception:
    """The parser, or what an entry point or `module:NAME` stands for.

    Raises:
        PluginError: it cannot be imported, or is no function.
    """
    if name == PARSER:
        return parse_frames
    perception: Perception = load_plugin(PERCEPTIONS, name)
    if not callable(perception):
        raise PluginError(
            f"perception {name!r}: expected a function of frames, found {type(perception).__name__}"
        )
    return perception
