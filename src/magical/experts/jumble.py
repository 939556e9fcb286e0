"""Blocks that belong to groups: how well they are clustered, how well each can be grasped.

A block counts when it is less than 1 / sqrt(3) times as far from its own cluster's centroid as
from any other's (appendix A.2.7).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from magical.experts.grasp import CLEARANCE, GATE, NEAREST_GATE, REACHABLE
from magical.experts.motions import HOLD
from magical.experts.sight import Sight
from magical.scene import Block
from magical.scene.constants import BLOCK_SIZE

Floats = NDArray[np.float64]
Ints = NDArray[np.intp]
Bools = NDArray[np.bool_]

SIDES = 16  # bearings from which a block may be grasped
TIP = 0.18  # units from a block's centre to each finger around it
TIP_LIMIT = 0.98  # largest coordinate of a finger
BLAME = 150.0  # control steps, per unit, that a robot or finger too close to a block costs
_ANGLES = np.arange(SIDES) * (2 * math.pi / SIDES)
_AHEAD = np.stack((-np.sin(_ANGLES), np.cos(_ANGLES)), axis=-1)  # (S, 2)
_RIGHT = np.stack((np.cos(_ANGLES), np.sin(_ANGLES)), axis=-1)


@dataclass(frozen=True, slots=True)
class Jumble:
    """The blocks as arrays: n blocks in some groups, S sides to grasp each from."""

    at: Floats  # (n, 2)
    group: Ints  # (n,)
    member: Floats  # (n, groups) one-hot
    strange: Bools  # (n, n) of different groups
    walled: Floats  # (n, S) control steps that walls cost who grasps a block from a side
    beset: Floats  # (n, S, n) control steps that each other block costs

    @staticmethod
    def of(sight: Sight, attribute: Callable[[Block], str]) -> "Jumble":
        """What is seen, grouped by an attribute."""
        values = [attribute(block) for block in sight.scene.blocks]
        present = sorted(set(values))
        group = np.array([present.index(value) for value in values])
        at = np.array(sight.resting)
        strange = group[:, None] != group
        return Jumble(at, group, np.eye(len(present))[group], strange, *_access(at))

    def ratios(self, at: Floats) -> Floats:
        """Own over nearest other squared distance to a centroid, for positions (..., n, 2)."""
        centroids = self.member.T @ at / self.member.sum(axis=0)[:, None]  # (..., groups, 2)
        squared = np.square(at[..., :, None, :] - centroids[..., None, :, :]).sum(axis=-1)
        own = (squared * self.member).sum(axis=-1)
        other = np.where(self.member > 0, np.inf, squared).min(axis=-1)
        ratios: Floats = own / np.maximum(other, 1e-6)
        return ratios  # (..., n)

    def access(self, present: Bools) -> Floats:
        """What grasping each block costs (..., n) while blocks (..., n, n) are around it."""
        blocks = np.matmul(self.beset, present[..., None].astype(np.float64))[..., 0]
        access: Floats = (self.walled + blocks).min(axis=-1)
        return access


def _access(at: Floats) -> tuple[Floats, Floats]:
    """`walled` and `beset` of a jumble; as the crowding of `grasp`, for all sides at once."""
    gates = at[:, None, None] - np.array((NEAREST_GATE, GATE))[:, None, None] * _AHEAD
    gate = np.where(_outside(gates[:, 1], REACHABLE) > 0, NEAREST_GATE, GATE)  # (n, S)
    stand = at[:, None] - HOLD * _AHEAD
    tips = np.stack((at[:, None] + TIP * _RIGHT, at[:, None] - TIP * _RIGHT))  # (2, n, S, 2)
    walled = 300.0 * _outside(stand, REACHABLE) + 40.0 * _outside(
        at[:, None] - gate[..., None] * _AHEAD, REACHABLE
    )
    walled += 8.0 * (_outside(tips, TIP_LIMIT) > 0).sum(axis=0)
    to = at - at[:, None]  # (n, n, 2): from row to column
    behind = np.clip(-(to @ _AHEAD.T).swapaxes(1, 2), HOLD, gate[..., None])  # (n, S, n)
    near = _length(to[:, None] + behind[..., None] * _AHEAD[:, None])
    beset = BLAME * np.maximum(0.0, CLEARANCE - 0.02 - near)
    for tip in tips:
        beset += BLAME * np.maximum(0.0, BLOCK_SIZE + 0.03 - _length(tip[:, :, None] - at))
    beset[np.arange(len(at)), :, np.arange(len(at))] = 0.0
    return walled, beset


def _outside(points: Floats, limit: float) -> Floats:
    """By how much the larger coordinate exceeds a limit."""
    beyond: Floats = np.maximum(0.0, np.abs(points).max(axis=-1) - limit)
    return beyond


def _length(offset: Floats) -> Floats:
    length: Floats = np.sqrt((offset * offset).sum(axis=-1))
    return length
