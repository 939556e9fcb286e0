"""Observation forms and their spaces."""

import numpy as np
import pytest
from gymnasium import spaces

from magical.errors import UnknownNameError
from magical.observe import PRESETS, RAW, STATE, PixelSpec, parse_observation
from magical.scene import View


@pytest.mark.parametrize(
    ("preset", "shape"),
    [
        ("LoRes4E", (96, 96, 12)),
        ("LoRes4A", (96, 96, 12)),
        ("LoRes3EA", (96, 96, 12)),
        ("LoResCHW4E", (12, 96, 96)),
    ],
)
def test_array_presets(preset: str, shape: tuple[int, ...]) -> None:
    space = PRESETS[preset].space
    assert isinstance(space, spaces.Box)
    assert space.shape == shape
    assert space.dtype == np.uint8


def test_dict_forms() -> None:
    for spec, shape in ((PRESETS["LoResStack"], (96, 96, 12)), (RAW, (384, 384, 3))):
        space = spec.space
        assert isinstance(space, spaces.Dict)
        assert {view: box.shape for view, box in space.items()} == {"allo": shape, "ego": shape}


def test_accepted_forms() -> None:
    assert parse_observation(None) is RAW
    assert parse_observation("raw") is RAW
    assert parse_observation("state") == STATE
    assert parse_observation("LoRes4A") is PRESETS["LoRes4A"]
    assert parse_observation({"parts": [["allo", 2]], "size": 32}) == PixelSpec(
        ((View.ALLO, 2),), size=32
    )


@pytest.mark.parametrize("bad", ["LoRes5E", 7, {"colour": 1}, {"parts": [["top", 1]]}])
def test_unknown_forms(bad: object) -> None:
    with pytest.raises(UnknownNameError, match="expected"):
        parse_observation(bad)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "fields",
    [
        {"parts": ()},
        {"parts": (("ego", 0),)},
        {"parts": (("ego", 1), ("ego", 2))},
        {"size": 0},
        {"samples": 0},
    ],
)
def test_impossible_forms(fields: dict[str, object]) -> None:
    with pytest.raises(ValueError, match="expected"):
        PixelSpec(**fields)  # type: ignore[arg-type]
