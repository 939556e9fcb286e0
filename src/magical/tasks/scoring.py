"""What the scoring rules measure: blocks in regions, in lines, near centroids."""

import math
from collections.abc import Sequence
from itertools import combinations, pairwise

import numpy as np
from numpy.typing import NDArray

from magical.errors import InvalidSceneError
from magical.scene import Point, Poses, Region, Scene

SUCCESS = 0.5  # an episode is a success above this score, halfway through every graded rule
INLIER_DISTANCE = 0.18  # units from a line, d_i (appendix A.2.4)
NEIGHBOUR_DISTANCE = 0.42  # units along a line, d_c (appendix A.2.4)

Distances = NDArray[np.float64]  # (..., number of blocks) squared units


def positions(scene: Scene, poses: Poses) -> list[Point]:
    """The blocks' centres in units; raises `InvalidSceneError` for poses of another scene."""
    if len(poses.blocks) != (count := len(scene.blocks)):
        raise InvalidSceneError(f"expected the scene's {count} blocks, found {len(poses.blocks)}")
    return [(x, y) for x, y, _ in poses.blocks.tolist()]


def blocks_inside(region: Region, scene: Scene, poses: Poses) -> set[int]:
    """Indices of the blocks whose centres lie in the region."""
    return {i for i, xy in enumerate(positions(scene, poses)) if region.contains(*xy)}


def longest_line(blocks: Sequence[Point]) -> int:
    """The number of blocks in the largest line through any pair (appendix A.2.4)."""
    longest = 1
    for a, b in combinations(blocks, 2):
        if a == b:
            continue
        length = math.dist(a, b)
        ux, uy = (b[0] - a[0]) / length, (b[1] - a[1]) / length
        offsets = [(x - a[0], y - a[1]) for x, y in blocks]
        near = [(x, y) for x, y in offsets if abs(ux * y - uy * x) <= INLIER_DISTANCE]
        count = 1
        for previous, following in pairwise(sorted(ux * x + uy * y for x, y in near)):
            count = count + 1 if following - previous <= NEIGHBOUR_DISTANCE else 1
            longest = max(longest, count)
    return longest


def centroid_distances(
    values: Sequence[str], points: NDArray[np.float64]
) -> tuple[Distances, Distances]:
    """Each block's squared distances (..., blocks) to its own centroid and the nearest other one.

    Args:
        values: each block's value of the attribute.
        points: the blocks' centres (..., blocks, 2), in units.
    """
    present = sorted(set(values))
    member = np.array([[value == a for a in present] for value in values])  # (blocks, values)
    centroids = (member.T @ points) / member.sum(axis=0)[:, None]  # (..., values, 2)
    offsets = points[..., :, None, :] - centroids[..., None, :, :]
    squared = np.square(offsets).sum(axis=-1)  # (..., blocks, values)
    own = np.where(member, squared, np.inf).min(axis=-1)
    other = np.where(member, np.inf, squared).min(axis=-1)
    return own, other
