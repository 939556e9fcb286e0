"""What an agent observes: pixels or state vectors, behind one interface."""

from magical.observe.pixels import PixelSpec
from magical.observe.presets import NAMED, PRESETS, RAW, Observation, make_spec, parse_spec
from magical.observe.spec import Component, EpisodeSource, FrameSource, ObservationSpec, Observer
from magical.observe.state_vector import STATE, StateSpec

__all__ = [
    "NAMED",
    "PRESETS",
    "RAW",
    "STATE",
    "Component",
    "EpisodeSource",
    "FrameSource",
    "Observation",
    "ObservationSpec",
    "Observer",
    "PixelSpec",
    "StateSpec",
    "make_spec",
    "parse_spec",
]
