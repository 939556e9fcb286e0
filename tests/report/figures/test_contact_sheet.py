"""The picture of all scenes."""

import gymnasium
import numpy as np
import pytest

from magical.errors import UnknownNameError
from magical.report import contact_sheet
from magical.report.figures.contact_sheet import MARGIN
from magical.tasks import TASKS, VARIANTS


def test_every_scene_is_the_environments_own() -> None:
    sheet = contact_sheet(["MoveToCorner"], ["Demo", "TestJitter"], seed=4, size=96)
    for column, variant in enumerate(("Demo", "TestJitter")):
        env = gymnasium.make(f"magical/MoveToCorner-{variant}-LoRes4A-v0")
        expected = env.reset(seed=4)[0][..., -3:]
        right = sheet.shape[1] - MARGIN - (1 - column) * (96 + MARGIN)
        bottom = sheet.shape[0] - MARGIN
        np.testing.assert_array_equal(sheet[bottom - 96 : bottom, right - 96 : right], expected)


def test_all_environments_have_a_place() -> None:
    sheet = contact_sheet(size=40)
    assert sheet.dtype == np.uint8
    assert sheet.shape[0] > 48 * len(TASKS)
    assert sheet.shape[1] > 48 * len(VARIANTS)


def test_a_missing_variant_has_a_dash() -> None:
    sheet = contact_sheet(["MoveToCorner"], ["Layout"], size=96)
    place = sheet[-96 - MARGIN : -MARGIN, -96 - MARGIN : -MARGIN]
    assert 0 < (place < 255).any(axis=2).sum() < 50


def test_unknown_names() -> None:
    with pytest.raises(UnknownNameError):
        contact_sheet(["MoveIt"])
    with pytest.raises(UnknownNameError):
        contact_sheet(variants=["Color"])
