"""What an agent is shown: presets, frame stacks, state vectors."""

from magical.observe.spec import PRESETS, RAW, STATE, Observation, PixelSpec, parse_observation
from magical.observe.vector import StateLayout, StateObserver

__all__ = [
    "PRESETS",
    "RAW",
    "STATE",
    "Observation",
    "PixelSpec",
    "StateLayout",
    "StateObserver",
    "parse_observation",
]
