"""Parsed scenes as tensors, and the network that moves a target to its destination.

The network's inputs are in the robot's frame. They contain no task, colours or shapes, only target,
destination, fingers, and the walls and blocks within range, so all tasks share it, and left and
right are interchangeable. The ranges are short: in a single scene, distant walls and blocks would
reveal where the robot is, and the network would learn what was done there.
"""

from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from magical.scene import NUM_ACTIONS
from magical_goals.objects.parser import ABSENT, FAR, ParsedFrames

ROBOT_TARGET = -1  # instead of a block's number
GRIP = 0.28  # units ahead of the robot's centre: where a gripped block's centre lies
# Units within which inputs are, but for the target's own: blocks from the robot's centre and its
# grip, walls from robot, target and destination.
BLOCK_RANGE, WALL_RANGE = 0.6, 0.4
FOCUS = 0.15  # units: the length scale of nearness
HELD = 2  # number of blocks nearest to the fingers that have separate inputs
HIDDEN = 256  # width of the layers


class ObjectTable(NamedTuple):
    """The objects of B scenes, at most N blocks and M regions; float32 unless stated."""

    robot: Tensor  # (B, 3) x, y, angle
    fingers: Tensor  # (B, 2) opening angles of the left and the right finger, rad
    blocks: Tensor  # (B, N, 2); far away where absent
    colours: Tensor  # (B, N) int64, ABSENT (-1) where absent
    shapes: Tensor  # (B, N) int64
    regions: Tensor  # (B, M, 4) centre x and y, half width and half height
    region_colours: Tensor  # (B, M) int64

    def select(self, rows: Tensor | slice) -> "ObjectTable":
        """The scenes that an index selects."""
        return ObjectTable(*(column[rows] for column in self))

    def without(self, gone: Tensor) -> "ObjectTable":
        """The same scenes without some blocks, (B, N) bool."""
        return self._replace(
            blocks=self.blocks.masked_fill(gone[..., None], FAR),
            colours=self.colours.masked_fill(gone, ABSENT),
            shapes=self.shapes.masked_fill(gone, ABSENT),
        )

    @property
    def size(self) -> int:
        """The number of scenes."""
        return len(self.robot)

    @property
    def present(self) -> Tensor:
        """Which blocks exist, (B, N) bool."""
        return self.colours >= 0

    @property
    def grip(self) -> Tensor:
        """The point between the fingers, (B, 2)."""
        angle = self.robot[:, 2]
        return self.robot[:, :2] + GRIP * torch.stack([-angle.sin(), angle.cos()], dim=1)


def to_table(parsed: ParsedFrames, device: str | torch.device = "cpu") -> ObjectTable:
    """The objects of B frames as tensors; as many block slots as they use, but at least two."""
    used = np.flatnonzero((parsed.colours != ABSENT).any(axis=0))
    count = 1 + max([1, *used.tolist()])
    names = ("blocks", "colours", "shapes")
    parsed = parsed._replace(**{name: getattr(parsed, name)[:, :count] for name in names})
    return ObjectTable(*(to_tensor(column).to(device) for column in parsed))


def to_tensor(array: NDArray[Any]) -> Tensor:
    """Floats as float32, integers as int64."""
    kind = np.float32 if array.dtype.kind == "f" else np.int64
    return torch.from_numpy(np.array(array, kind))


def control_inputs(
    table: ObjectTable,
    targets: Tensor,
    destinations: Tensor,
    mirrored: Tensor | None = None,
) -> tuple[Tensor, Tensor, Tensor]:
    """Inputs (B, F); inputs for every block (B, N, T); which blocks are near (B, N).

    Left and right are exchanged in scenes that are `mirrored`, (B,).
    """
    view = _RobotView(table, mirrored)
    robot = targets == ROBOT_TARGET
    rows = torch.arange(table.size, device=targets.device)
    start = torch.where(robot[:, None], destinations, table.blocks[rows, targets.clamp(min=0)])
    target, end = view.see(torch.stack([start, destinations], dim=1)).unbind(dim=1)
    blocks = view.see(table.blocks)
    numbers = torch.arange(blocks.shape[1], device=blocks.device)
    is_target = (numbers == targets[:, None])[..., None].float()
    ends = torch.stack([table.robot[:, :2], start, destinations], dim=1)
    own = torch.cat(
        [
            robot[:, None].float(),
            _polar(torch.stack([target, end, end - target], dim=1)),
            _held(blocks, is_target, table.present),
            view.fingers(),
            view.walls(ends),
        ],
        dim=1,
    )
    offsets = blocks, blocks - end[:, None], blocks - target[:, None]
    near = table.present & (blocks.norm(dim=2) < BLOCK_RANGE)
    return own, torch.cat([_polar(torch.stack(offsets, dim=2)), is_target], dim=2), near


class _RobotView:
    """Maps workspace coordinates to the robot's frame (x right, y ahead), mirrored or not."""

    def __init__(self, table: ObjectTable, mirrored: Tensor | None) -> None:
        self._table = table
        none = torch.zeros(table.size, dtype=torch.bool, device=table.robot.device)
        self._mirrored = (none if mirrored is None else mirrored)[:, None]  # (B, 1)
        angle = table.robot[:, 2:]  # (B, 1)
        self._cos, self._sin = angle.cos(), angle.sin()

    def see(self, places: Tensor) -> Tensor:
        """Places (B, K, 2) as seen from the robot."""
        return self.turn(places - self._table.robot[:, None, :2])

    def turn(self, vectors: Tensor) -> Tensor:
        """Vectors (B, K, 2) in the robot's frame."""
        right = vectors[..., 0] * self._cos + vectors[..., 1] * self._sin
        ahead = vectors[..., 1] * self._cos - vectors[..., 0] * self._sin
        return torch.stack([torch.where(self._mirrored, -right, right), ahead], dim=-1)

    def fingers(self) -> Tensor:
        """The opening angles of both fingers, scaled to about 1: (B, 2)."""
        values = 3 * self._table.fingers
        return torch.where(self._mirrored, values.flip(1), values)

    def walls(self, places: Tensor) -> Tensor:
        """Direction and nearness of the walls next to places (B, K, 2), nearer first: (B, 6K)."""
        across = torch.where(places > 0, 1.0 - places, -1.0 - places)
        vectors = self.turn(torch.diag_embed(across).flatten(1, 2)).view(*places.shape, 2)
        distances, order = vectors.norm(dim=3).sort(dim=2)  # (B, K, 2)
        vectors = vectors.gather(2, order[..., None].expand(-1, -1, -1, 2))
        distances = distances[..., None]
        nearness = (1.0 - distances / WALL_RANGE).clamp(0.0, 1.0)
        return torch.cat([vectors / (distances + 0.05) * nearness, nearness], dim=3).flatten(1)


def _polar(vectors: Tensor) -> Tensor:
    """Vectors (..., K, 2) with their length, direction and nearness: (..., 6K)."""
    length = vectors.norm(dim=-1, keepdim=True)
    parts = vectors, length, vectors / (length + 0.05), torch.exp(-length / FOCUS)
    return torch.cat(parts, dim=-1).flatten(-2)


def _held(blocks: Tensor, is_target: Tensor, present: Tensor) -> Tensor:
    """Inputs for the blocks nearest to the fingers: (B, HELD * 5)."""
    offsets = blocks - torch.tensor([0.0, GRIP], device=blocks.device)
    distances = offsets.norm(dim=2).masked_fill(~present, BLOCK_RANGE)
    nearest = distances.argsort(dim=1)[:, :HELD, None]
    near = (distances[..., None].gather(1, nearest) < BLOCK_RANGE).float()
    offsets = offsets.gather(1, nearest.expand(-1, -1, 2))
    length = offsets.norm(dim=2, keepdim=True).clamp(max=BLOCK_RANGE)
    parts = torch.cat([offsets, length, torch.ones_like(near), is_target.gather(1, nearest)], dim=2)
    held: Tensor = (parts * near).flatten(1)
    return held


class Controller(nn.Module):
    """Predicts logits of the 18 actions; max-pooling over blocks makes their order irrelevant."""

    def __init__(self) -> None:
        super().__init__()
        self.block = nn.Sequential(nn.LazyLinear(64), nn.ReLU(), nn.Linear(64, 64), nn.ReLU())
        self.layers = nn.Sequential(
            nn.LazyLinear(HIDDEN),
            nn.ReLU(),
            nn.Linear(HIDDEN, HIDDEN),
            nn.ReLU(),
            nn.Linear(HIDDEN, HIDDEN),
            nn.ReLU(),
            nn.Linear(HIDDEN, NUM_ACTIONS),
        )

    def forward(self, own: Tensor, blocks: Tensor, near: Tensor) -> Tensor:
        """Logits (B, 18) for the inputs that `control_inputs` returns."""
        pooled = (self.block(blocks) * near[..., None]).amax(dim=1)
        logits: Tensor = self.layers(torch.cat([own, pooled], dim=1))
        return logits
