"""Goals of MoveToRegion's expert where the region is at a wall."""

import pytest

from magical.experts import rollout

# Scenes with regions in whose depth the open fingers would meet the wall.
AT_WALLS = [("TestAll", 5027), ("TestAll", 5125), ("TestAll", 5157), ("TestLayout", 5320)]


@pytest.mark.parametrize(("variant", "seed"), AT_WALLS)
def test_the_robot_stays_in_a_region_at_a_wall(variant: str, seed: int) -> None:
    episode = rollout("MoveToRegion", variant, seed)
    region = episode.scene.regions[0]
    inside = [region.contains(x, y) for x, y, _ in episode.poses[:, 0].tolist()]
    assert inside == sorted(inside)
    assert episode.score == 1.0
