"""What an agent observes: pixels or state vectors, behind one interface."""

from magical.observe.pixels import PixelSpec
from magical.observe.presets import PRESETS, RAW, Observation, make_spec, parse_spec
from magical.observe.spec import ObservationSpec, Observer
from magical.observe.state_vector import STATE, StateSpec

__all__ = [
    "PRESETS",
    "RAW",
    "STATE",
    "Observation",
    "ObservationSpec",
    "Observer",
    "PixelSpec",
    "StateSpec",
    "make_spec",
    "parse_spec",
]
