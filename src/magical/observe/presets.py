"""Observations by name: the published presets, raw frames, state vectors.

Source of the presets: docs/specification.md, section 7.
"""

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from magical.errors import PluginError, UnknownNameError
from magical.files import parse_json
from magical.messages import quoted
from magical.observe.pixels import STACK, PixelSpec
from magical.observe.spec import ObservationSpec
from magical.observe.state_vector import STATE, StateSpec
from magical.plugins import is_plugin, load_plugin, plugins
from magical.scene import View
from magical.scene.constants import RAW_FRAME_SIZE
from magical.tasks import Task

# What `observation=` accepts: a name, a specification, a mapping of PixelSpec's fields, or None.
Observation = str | ObservationSpec | Mapping[str, Any] | None

# The presets that environment ids may name.
PRESETS: Mapping[str, PixelSpec] = {
    "LoResStack": PixelSpec(((View.ALLO, STACK), (View.EGO, STACK)), separate=True),
    "LoRes4E": PixelSpec(((View.EGO, STACK),)),
    "LoRes4A": PixelSpec(((View.ALLO, STACK),)),
    "LoRes3EA": PixelSpec(((View.ALLO, 1), (View.EGO, STACK - 1))),
    "LoResCHW4E": PixelSpec(((View.EGO, STACK),), channels_first=True),
}
RAW = PixelSpec(((View.ALLO, 1), (View.EGO, 1)), size=RAW_FRAME_SIZE, separate=True)

# Entry points for other distributions' observations: each is an `ObservationSpec`, or a function
# from the task to one, whose `to_dict` returns the name of the entry point, or `module:NAME`, for
# records of evaluations.
GROUP = "magical.observations"


def make_spec(observation: Observation, task: Task) -> ObservationSpec:
    """The specification that `observation=` selects for a task.

    Args:
        observation: the name of a preset or of an entry point, `raw` or `None` (both views at
            384 x 384), `state`, `module:NAME`, an `ObservationSpec`, or a mapping of `PixelSpec`'s
            fields.
        task: state vectors have slots for its largest variant.

    Raises:
        UnknownNameError: none of these.
        ObservationError, RenderError: invalid fields of `PixelSpec`.
        PluginError: another distribution's observation cannot be found, or is something else.
    """
    names = sorted(field.name for field in fields(PixelSpec))
    made: Any = RAW if observation is None else observation
    if isinstance(made, str):
        built_in = {**PRESETS, "raw": RAW, STATE: StateSpec(task.max_blocks, task.max_regions)}
        if made in built_in:
            return built_in[made]
        if is_plugin(GROUP, made):
            offered = load_plugin(GROUP, made)
            made = offered(task) if callable(offered) and not _is_spec(offered) else offered
            if not _is_spec(made):
                raise PluginError(
                    f"observation {observation!r}: expected an ObservationSpec, or a function from "
                    f"the task to one, found {type(made).__name__}"
                )
    elif isinstance(made, Mapping) and set(made) <= set(names):
        return PixelSpec(**made)
    if _is_spec(made):
        spec: ObservationSpec = made
        return spec
    known = ", ".join((*PRESETS, "raw", STATE, *plugins(GROUP)))
    raise UnknownNameError(
        f"observation {quoted(observation)} is unknown; expected one of {known}, module:NAME, an "
        f"ObservationSpec, or a mapping with some of {names}"
    )


def parse_spec(text: str, task: Task) -> ObservationSpec:
    """Parse an observation from untrusted text: a name, or `PixelSpec`'s fields as JSON.

    Unlike `make_spec`, this does not import `module:NAME`: the name must be one of this package's
    or that of an entry point. Raises `UnknownNameError`, for invalid fields too, and `PluginError`.
    """
    if text.startswith("{"):
        return parse_json(text, PixelSpec, "observation", UnknownNameError)
    known = (*PRESETS, "raw", STATE, *plugins(GROUP))
    if text not in known:
        raise UnknownNameError(
            f"observation {quoted(text)} is unknown here; expected one of {', '.join(known)}"
        )
    return make_spec(text, task)


def _is_spec(observation: object) -> bool:
    # isinstance of a protocol would read its properties, and `network_shape` may raise.
    return callable(getattr(type(observation), "observer", None))
