"""Scenes as plain frozen data. Nothing here is simulated, rendered or scored."""

from magical.scene.actions import (
    ACTION_NAMES,
    ACTIONS,
    NOOP,
    NUM_ACTIONS,
    Action,
    to_continuous,
    to_discrete,
)
from magical.scene.poses import Poses, State
from magical.scene.scene import (
    COLOURS,
    SHAPES,
    Block,
    Colour,
    Dynamics,
    Pose,
    Region,
    Scene,
    Shape,
    View,
)

__all__ = [
    "ACTIONS",
    "ACTION_NAMES",
    "COLOURS",
    "NOOP",
    "NUM_ACTIONS",
    "SHAPES",
    "Action",
    "Block",
    "Colour",
    "Dynamics",
    "Pose",
    "Poses",
    "Region",
    "Scene",
    "Shape",
    "State",
    "View",
    "to_continuous",
    "to_discrete",
]
