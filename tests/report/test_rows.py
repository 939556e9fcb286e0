"""Which evaluations of a method share a row, and what rows are called."""

from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from magical.evaluation import Entry
from magical.report.found import by_row
from tests.report.conftest import make_entry


def labels(*entries: Entry) -> list[str]:
    """The label of each entry's row."""
    rows = by_row(enumerate(entries), lambda pair: pair[1])
    found = {number: label for label, row in rows.items() for number, _ in row}
    return [found[number] for number in range(len(entries))]


def entry(*tasks: str, rollouts: int = 100, method: str = "m", **fields: Any) -> Entry:
    return make_entry(method, {f"{task}-Demo": [0.0] * rollouts for task in tasks}, **fields)


def test_single_tasks_share_a_row_whatever_their_tasks_and_horizons() -> None:
    # Tasks with one horizon cannot be evaluated with the published one.
    runs = entry("ClusterColour", horizon="published"), entry("MoveToRegion"), entry("MakeLine")
    assert labels(*runs) == ["m"] * 3
    assert labels(*runs, entry("ClusterColour")) == ["m, horizon 240", "m", "m", "m"]


def test_a_label_says_what_differs_and_nothing_else() -> None:
    shown: dict[str, Any] = {"observation": "LoRes4E"}
    assert labels(entry("MakeLine", seed=3), entry("MakeLine", seed=3)) == ["m"] * 2
    assert labels(
        entry("MakeLine", **shown),
        entry("MakeLine", seed=1, rollouts=5, observation="LoRes4A"),
        entry("MakeLine", **shown, action_space="continuous"),
        entry("MakeLine", **shown, privileged=True),
        entry("MakeLine", **shown, nudge=1e-4),
        entry("MakeLine", method="other", nudge=1e-4),
    ) == [
        "m, LoRes4E",
        "m, LoRes4A, 5 rollouts, seed 1",
        "m, LoRes4E, continuous",
        "m, LoRes4E, privileged",
        "m, LoRes4E, nudge 0.0001",
        "other, nudge 0.0001",
    ]


def test_methods_named_like_a_row_stay_apart() -> None:
    found = labels(
        entry("MakeLine"), entry("MakeLine", seed=1), entry("MakeLine", method="m, seed 1")
    )
    assert len(set(found)) == 3


@given(
    st.lists(
        st.builds(
            entry,
            st.sampled_from(["ClusterColour", "ClusterShape", "MakeLine"]),
            st.sampled_from(["ClusterColour", "MakeLine"]),
            rollouts=st.sampled_from([1, 2]),
            horizon=st.sampled_from(["appendix", "published", "240", "320"]),
            seed=st.sampled_from([0, 1]),
        ),
        max_size=8,
    )
)
def test_a_cell_holds_equal_evaluations_only(entries: list[Entry]) -> None:
    rows = by_row(entries, lambda found: found)
    assert sorted(map(id, entries)) == sorted(id(e) for row in rows.values() for e in row)
    for row in rows.values():
        for env_id in {score.env_id for found in row for score in found.scores}:
            on = [e.evaluated for e in row if env_id in e.evaluated.env_ids]
            steps = {env_id.task_spec.resolve_horizon(how.horizon) for how in on}
            settings = {tuple((how.settings | {"horizon": None}).items()) for how in on}
            assert (len(steps), len(settings)) == (1, 1)
