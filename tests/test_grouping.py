"""Items in groups."""

from magical.grouping import group_by


def test_keys_and_items_stay_in_order() -> None:
    groups = group_by(["b1", "a1", "b2"], lambda item: item[0])
    assert list(groups.items()) == [("b", ["b1", "b2"]), ("a", ["a1"])]
