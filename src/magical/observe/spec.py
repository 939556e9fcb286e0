"""What an agent is shown: pixel observations and the five published presets.

Source: appendix A.1; docs/specification.md, section 7.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from gymnasium import spaces

from magical.errors import UnknownNameError
from magical.scene.vocabulary import View, parse_word

LOW_RESOLUTION = 96  # pixels
RAW_RESOLUTION = 384  # pixels
STACK = 4  # frames


@dataclass(frozen=True, slots=True)
class PixelSpec:
    """A pixel observation: the last `frames` frames of each view, oldest first, uint8 RGB.

    `parts` names the views in channel order, each with its number of frames; with `separate` the
    observation is a dict of views, otherwise one array (size, size, 3 * frames), or with
    `channels_first` (3 * frames, size, size). `samples` x `samples` samples are averaged in each
    pixel; `None` chooses as many as make 384 across, as the published pipeline does. Before the
    first step the first frame is repeated.
    """

    parts: tuple[tuple[View, int], ...] = ((View.EGO, STACK),)
    size: int = LOW_RESOLUTION
    samples: int | None = None
    separate: bool = False
    channels_first: bool = False

    def __post_init__(self) -> None:
        parts = tuple((parse_word(View, view), int(frames)) for view, frames in self.parts)
        object.__setattr__(self, "parts", parts)
        if not parts or min(frames for _, frames in parts) < 1:
            raise ValueError(f"parts: expected views with at least one frame each, found {parts}")
        if len({view for view, _ in parts}) < len(parts):
            raise ValueError(f"parts: expected each view once, found {parts}")
        if self.size < 1 or (self.samples is not None and self.samples < 1):
            raise ValueError(
                f"expected positive size and samples, found {self.size} and {self.samples}"
            )

    def shape(self, frames: int) -> tuple[int, int, int]:
        """The shape of an array of `frames` stacked frames."""
        channels = 3 * frames
        if self.channels_first:
            return channels, self.size, self.size
        return self.size, self.size, channels

    @property
    def space(self) -> spaces.Space[Any]:
        """The Gymnasium space of this observation."""

        def box(frames: int) -> spaces.Box:
            return spaces.Box(0, 255, self.shape(frames), np.uint8)

        if self.separate:
            return spaces.Dict({str(view): box(frames) for view, frames in self.parts})
        return box(sum(frames for _, frames in self.parts))


_BOTH = (View.ALLO, View.EGO)

PRESETS: Mapping[str, PixelSpec] = {
    "LoResStack": PixelSpec(tuple((view, STACK) for view in _BOTH), separate=True),
    "LoRes4E": PixelSpec(((View.EGO, STACK),)),
    "LoRes4A": PixelSpec(((View.ALLO, STACK),)),
    "LoRes3EA": PixelSpec(((View.ALLO, 1), (View.EGO, STACK - 1))),
    "LoResCHW4E": PixelSpec(((View.EGO, STACK),), channels_first=True),
}

RAW = PixelSpec(tuple((view, 1) for view in _BOTH), size=RAW_RESOLUTION, separate=True)

STATE = "state"  # the name of the state-vector observation
Observation = str | PixelSpec | Mapping[str, Any] | None


def parse_observation(observation: Observation) -> PixelSpec | str:
    """Turn what `observation=` accepts into a `PixelSpec`, or `STATE`.

    Accepts a preset's name, `"raw"` or `None` (the raw dict), `"state"`, a `PixelSpec`, or a
    mapping of its fields. Raises `UnknownNameError` for anything else.
    """
    if isinstance(observation, PixelSpec) or observation == STATE:
        return observation
    if observation is None or observation == "raw":
        return RAW
    if isinstance(observation, str) and observation in PRESETS:
        return PRESETS[observation]
    names = {field.name for field in fields(PixelSpec)}
    if isinstance(observation, Mapping) and set(observation) <= names:
        return PixelSpec(**observation)
    raise UnknownNameError(
        f"observation {observation!r} is unknown; expected one of {', '.join(PRESETS)}, raw, "
        f"{STATE}, a PixelSpec, or a mapping with some of {sorted(names)}"
    )
