"""Observations by name: the published presets, raw frames, state vectors.

Source of the presets: docs/specification.md, section 7.
"""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any, TypeGuard

from magical.errors import PluginError, UnknownNameError
from magical.files import parse_json
from magical.messages import quoted
from magical.observe.pixels import STACK, PixelSpec
from magical.observe.spec import ObservationSpec
from magical.observe.state_vector import STATE, StateSpec
from magical.plugins import is_plugin, load_plugin, plugins
from magical.scene.constants import RAW_FRAME_SIZE
from magical.scene.vocabulary import View
from magical.tasks import Task

# What `observation=` accepts: a name, a specification, a mapping of PixelSpec's fields, or None.
Observation = str | ObservationSpec | Mapping[str, Any] | None

_BOTH = (View.ALLO, View.EGO)

# The presets that environment ids may name.
PRESETS: Mapping[str, PixelSpec] = {
    "LoResStack": PixelSpec(tuple((view, STACK) for view in _BOTH), separate=True),
    "LoRes4E": PixelSpec(((View.EGO, STACK),)),
    "LoRes4A": PixelSpec(((View.ALLO, STACK),)),
    "LoRes3EA": PixelSpec(((View.ALLO, 1), (View.EGO, STACK - 1))),
    "LoResCHW4E": PixelSpec(((View.EGO, STACK),), channels_first=True),
}

RAW = PixelSpec(tuple((view, 1) for view in _BOTH), size=RAW_FRAME_SIZE, separate=True)

# Entry points for other distributions' observations: each is an `ObservationSpec`, or a function
# from the task to one, whose `to_dict` returns the name of the entry point, or `module:NAME`, for
# records of evaluations.
GROUP = "magical.observations"

# This package's other named observations, as functions of the task.
NAMED: Mapping[str, Callable[[Task], ObservationSpec]] = {
    "raw": lambda task: RAW,
    STATE: lambda task: StateSpec(task.max_blocks, task.max_regions),
}


def make_spec(observation: Observation, task: Task) -> ObservationSpec:
    """The specification that `observation=` selects for a task.

    Args:
        observation: the name of a preset, of another observation in `NAMED` or of an entry point,
            `module:NAME`, `None` (both views at 384 x 384), an `ObservationSpec`, or a mapping of
            `PixelSpec`'s fields.
        task: state vectors have slots for its largest variant.

    Raises:
        UnknownNameError: none of these.
        ObservationError: invalid fields of `PixelSpec`.
        PluginError: another distribution's observation cannot be found, or is something else.
    """
    if observation is None:
        return RAW
    if _is_spec(observation):
        return observation
    names = {field.name for field in dataclasses.fields(PixelSpec)}
    if isinstance(observation, Mapping) and set(observation) <= names:
        return PixelSpec(**observation)
    if isinstance(observation, str) and observation in PRESETS:
        return PRESETS[observation]
    if isinstance(observation, str) and observation in NAMED:
        return NAMED[observation](task)
    if isinstance(observation, str) and is_plugin(GROUP, observation):
        offered = load_plugin(GROUP, observation)
        made = offered(task) if callable(offered) and not _is_spec(offered) else offered
        if not _is_spec(made):
            raise PluginError(
                f"observation {observation!r}: expected an ObservationSpec, or a function from the "
                f"task to one, found {type(made).__name__}"
            )
        return made
    known = ", ".join((*PRESETS, *NAMED, *plugins(GROUP)))
    raise UnknownNameError(
        f"observation {quoted(observation)} is unknown; expected one of {known}, module:NAME, an "
        f"ObservationSpec, or a mapping with some of {sorted(names)}"
    )


def parse_spec(text: str, task: Task) -> ObservationSpec:
    """Parse an observation from untrusted text: a name, or `PixelSpec`'s fields as JSON.

    Unlike `make_spec`, this does not import `module:NAME`: the name must be one of this package's
    or that of an entry point. Raises `UnknownNameError`, for invalid fields too, and `PluginError`.
    """
    if text.startswith("{"):
        return parse_json(text, PixelSpec, "observation", UnknownNameError)
    if text in PRESETS or text in NAMED or text in plugins(GROUP):
        return make_spec(text, task)
    known = ", ".join((*PRESETS, *NAMED, *plugins(GROUP)))
    raise UnknownNameError(f"observation {quoted(text)} is unknown here; expected one of {known}")


def _is_spec(observation: Any) -> TypeGuard[ObservationSpec]:
    # isinstance of a protocol would read its properties, and `network_shape` may raise.
    return callable(getattr(type(observation), "observer", None))
