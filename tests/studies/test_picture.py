"""The heat map of differences from the published scores."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from magical.evaluation.statistics import Spread
from studies.published_tables.cells import ComparedCell
from studies.published_tables.picture import _figure

TASKS = ("MoveToCorner", "MoveToRegion", "FixColour")


def cell(task: str) -> ComparedCell:
    return ComparedCell("A", task, "Demo", np.array([0.6, 0.8]), Spread(0.5, 0.1))


def shown(panels: Mapping[str, Sequence[ComparedCell]]) -> dict[str, tuple[list[str], Any]]:
    """Title, tasks and lower limit of each panel."""
    axes = [place for place in _figure(panels, TASKS).axes if place.get_title()]
    return {
        place.get_title(): (
            [label.get_text() for label in place.get_yticklabels()],
            place.get_ylim()[0],
        )
        for place in axes
    }


def test_a_panel_shows_the_tasks_that_were_run_in_order_as_high_as_its_neighbours() -> None:
    panels = {"A": [cell("FixColour"), cell("MoveToCorner")], "B": [cell("MoveToRegion")]}
    assert shown(panels) == {
        "A": (["MoveToCorner", "FixColour"], 1.5),
        "B": (["MoveToRegion"], 1.5),
    }


def test_a_panel_without_cells_shows_all_tasks() -> None:
    assert shown({"A": []}) == {"A": (list(TASKS), 2.5)}
