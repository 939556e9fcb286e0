"""Observation specifications and their spaces."""

from typing import Any

import numpy as np
import pytest
from gymnasium import spaces

from magical.envs.env import MagicalEnv
from magical.errors import PluginError, UnknownNameError
from magical.observe import (
    PRESETS,
    RAW,
    ObservationSpec,
    Observer,
    PixelSpec,
    StateSpec,
    make_spec,
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


def test_a_specification_from_outside_is_accepted() -> None:
    class Wrapped:
        """A kind of observation that the package does not know."""

        def __init__(self, spec: ObservationSpec) -> None:
            self._spec = spec

        def __getattr__(self, name: str) -> Any:
            return getattr(self._spec, name)

        def observer(self, out: Any = None) -> Observer:
            return self._spec.observer(out)

    specs: list[Any] = [Wrapped(PRESETS["LoResStack"]), Wrapped(StateSpec(3, 1))]
    for spec in specs:
        assert make_spec(spec, TASK) is spec
    kind: Any = Wrapped
    with pytest.raises(UnknownNameError, match="expected"):
        make_spec(kind, TASK)


@pytest.mark.parametrize("bad", ["LoRes5E", 7, {"colour": 1}, {"parts": [["top", 1]]}])
def test_unknown_specs(bad: object) -> None:
    with pytest.raises(UnknownNameError, match="expected"):
        make_spec(bad, TASK)


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


def test_a_picture_has_all_frames_side_by_side() -> None:
    for name, spec in PRESETS.items():
        env = MagicalEnv("MoveToRegion", "Demo", observation=name)
        observation = env.reset(seed=0)[0]
        picture = spec.picture(observation)
        frames = sum(count for _, count in spec.parts)
        assert picture.shape == (spec.size, spec.size * frames, 3)
        newest = spec.stacks(observation)[-1][..., -3:]
        np.testing.assert_array_equal(picture[:, -spec.size :], newest)


def test_a_state_vector_has_no_picture() -> None:
    spec: ObservationSpec = StateSpec(3, 1)
    assert spec.picture(np.zeros(spec.network_shape, np.float32)) is None


def test_observations_of_other_distributions_are_named_by_module() -> None:
    task = get_task("MakeLine")
    assert make_spec("magical.observe.presets:RAW", task) == make_spec(None, task)
    with pytest.raises(PluginError, match="no_such_module"):
        make_spec("no_such_module:SPEC", task)
