"""Goals of MoveToRegion's expert where the region is at a wall."""

import pytest

from magical.experts import rollout

# Variant, scene and strategy: regions in whose depth the open fingers would meet the wall.
AT_WALLS = [
    ("TestAll", 5027, 5027),
    ("TestAll", 5087, 1),
    ("TestAll", 5125, 5125),
    ("TestAll", 5157, 5157),
    ("TestLayout", 5193, 205193),
    ("TestLayout", 5320, 5320),
]


@pytest.mark.parametrize(("variant", "seed", "strategy_seed"), AT_WALLS)
def test_the_robot_stays_in_a_region_at_a_wall(variant: str, seed: int, strategy_seed: int) -> None:
    episode = rollout("MoveToRegion", variant, seed, strategy_seed=strategy_seed)
    region = episode.scene.regions[0]
    inside = [region.contains(x, y) for x, y, _ in episode.poses[:, 0].tolist()]
    assert inside == sorted(inside)
    assert episode.score == 1.0
