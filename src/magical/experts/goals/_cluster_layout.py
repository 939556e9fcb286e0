"""Blocks in groups, as arrays: how well they are clustered, how well each can be grasped."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from magical.experts.array_geometry import Bools, Floats, Ints
from magical.experts.grasp_costs import Obstruction, mutual_obstruction
from magical.experts.state_view import StateView
from magical.scene import Block


@dataclass(frozen=True, slots=True)
class ClusterLayout:
    """Where n blocks come to rest, and their groups: the values of the clustered attribute."""

    positions: Floats  # (n, 2)
    group: Ints  # (n,) index of the block's group
    members: Floats  # (n, groups) 1 where the block is in the group

    @staticmethod
    def from_view(view: StateView, attribute: Callable[[Block], str]) -> "ClusterLayout":
        """The present blocks, grouped by an attribute."""
        values = [attribute(block) for block in view.scene.blocks]
        _, group = np.unique(values, return_inverse=True)
        positions = np.array(view.resting_blocks)
        return ClusterLayout(positions, group, np.eye(group.max() + 1)[group])

    @property
    def groups(self) -> int:
        """The number of groups."""
        return len(self.members[0])

    @property
    def different(self) -> Bools:
        """Which pairs of blocks (n, n) are of different groups."""
        unequal: Bools = self.group[:, None] != self.group
        return unequal

    def distance_ratios(self, positions: Floats) -> Floats:
        """Own over nearest other squared distance to a centroid, (..., n), at (..., n, 2).

        A block counts as correctly clustered below 1 / 3 (appendix A.2.7).
        """
        centroids = self.members.T @ positions / self.members.sum(axis=0)[:, None]
        offsets = positions[..., :, None, :] - centroids[..., None, :, :]  # (..., n, groups, 2)
        squared = np.square(offsets).sum(axis=-1)
        own = (squared * self.members).sum(axis=-1)
        other = np.where(self.members > 0, np.inf, squared).min(axis=-1)
        ratios: Floats = own / np.maximum(other, 1e-6)
        return ratios


@dataclass(frozen=True, slots=True)
class GraspAccess:
    """How well each block of a layout can be grasped, depending on which others are there."""

    obstruction: Obstruction
    present: Floats  # (n,) control steps that grasping each block costs with all others there
    rank: Ints  # (n,) each block's place in the order of that cost

    @staticmethod
    def of(layout: ClusterLayout) -> "GraspAccess":
        """The grasps of a layout's blocks as they are."""
        obstruction = mutual_obstruction(layout.positions)
        present = (obstruction.walls + obstruction.blocks.sum(axis=-1)).min(axis=1)
        # Two blocks that hinder each other cost the same but for rounding, which must not decide.
        rank = present.round(6).argsort(kind="stable").argsort()
        return GraspAccess(obstruction, present, rank)

    def cost(self, others: Bools) -> Floats:
        """Control steps (..., n) with only the blocks `others` (..., n, n) around each block."""
        blocks = self.obstruction.blocks @ others[..., None].astype(np.float64)
        cost: Floats = (self.obstruction.walls + blocks[..., 0]).min(axis=-1)
        return cost
