"""Observation specifications and their spaces."""

from typing import Any

import numpy as np
import pytest
from gymnasium import spaces

from magical.errors import PluginError, UnknownNameError
from magical.observe import (
    PRESETS,
    RAW,
    Observer,
    PixelSpec,
    StateSpec,
    make_spec,
    parse_spec,
)
from magical.scene import View
from magical.tasks import get_task

TASK = get_task("FindDupe")


def test_spaces_of_the_presets() -> None:
    array = {name: spec.space for name, spec in PRESETS.items() if not spec.separate}
    assert {box.dtype for box in array.values()} == {np.dtype(np.uint8)}
    assert {name: box.shape for name, box in array.items()} == {
        "LoRes4E": (96, 96, 12),
        "LoRes4A": (96, 96, 12),
        "LoRes3EA": (96, 96, 12),
        "LoResCHW4E": (12, 96, 96),
    }
    for spec, shape in ((PRESETS["LoResStack"], (96, 96, 12)), (RAW, (384, 384, 3))):
        space = spec.space
        assert isinstance(space, spaces.Dict)
        assert {view: box.shape for view, box in space.items()} == {"allo": shape, "ego": shape}


def test_accepted_specs() -> None:
    assert make_spec(None, TASK) is RAW
    assert make_spec("raw", TASK) is RAW
    assert make_spec("state", TASK) == StateSpec(TASK.max_blocks, TASK.max_regions)
    assert make_spec("LoRes4A", TASK) is PRESETS["LoRes4A"]
    assert make_spec({"parts": [["allo", 2]], "size": 32}, TASK) == PixelSpec(
        ((View.ALLO, 2),), size=32
    )


class Outside:
    """A kind of observation that the package does not know."""

    def observer(self, out: Any = None) -> Observer:
        return StateSpec(3, 1).observer(out)


def test_a_specification_from_outside_is_accepted() -> None:
    spec: Any = Outside()
    assert make_spec(spec, TASK) is spec


@pytest.mark.parametrize("bad", ["LoRes5E", 7, {"colour": 1}, {"parts": [["top", 1]]}, Outside])
def test_unknown_specs(bad: Any) -> None:
    with pytest.raises(UnknownNameError, match="expected"):
        make_spec(bad, TASK)


@pytest.mark.parametrize("text", ["LoRes5E", "{", '{"size": "1"}', '{"size": 0}', "os:environ"])
def test_text_from_outside_imports_nothing(text: str) -> None:
    with pytest.raises(UnknownNameError, match="expected"):
        parse_spec(text, TASK)
    assert parse_spec('{"size": 32}', TASK) == PixelSpec(size=32)


@pytest.mark.parametrize(
    "fields",
    [
        {"parts": ()},
        {"parts": (("ego", 0),)},
        {"parts": (("ego", 1), ("ego", 2))},
        {"size": 0},
        {"size": 4096, "samples": 4},
        {"size": 1025, "samples": 4},
        {"samples": 0},
    ],
)
def test_impossible_specs(fields: dict[str, object]) -> None:
    with pytest.raises(ValueError, match="expected"):
        PixelSpec(**fields)


def test_observations_of_other_distributions_are_named_by_module() -> None:
    task = get_task("MakeLine")
    assert make_spec("magical.observe:RAW", task) == make_spec(None, task)
    with pytest.raises(PluginError, match="no_such_module"):
        make_spec("no_such_module:SPEC", task)
