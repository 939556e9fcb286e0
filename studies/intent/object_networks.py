"""Parsed objects for a generic network, to be cloned: perception of `object-bc`, no relations.

magical train bc --network studies.intent.object_networks:DEEP_SET --observation LoRes4A ...

Architectures, in the sense of `magical_baselines.networks`, whose "convolutions" parse the oldest
and the newest frame of a stack and take robot, blocks and regions as a set: a deep set (Zaheer et
al., NeurIPS 2017) or a set transformer (attention among the elements, as in Lee et al., ICML 2019).
They need images without augmentation.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from magical.observe import CHANNELS
from magical.runs import PARSER_SOURCES
from magical.scene import Colour, Shape
from magical_goals.objects.control import ObjectTable, to_table
from magical_goals.objects.parser import parse_frames

COLOURS, SHAPES = len(Colour), len(Shape)
KINDS = 3  # robot, block, region
POSE = 7  # robot: x, y, sine and cosine of its angle, its motion over the stack in its own frame
FEATURES = KINDS + POSE + 2 + 2 + 2 + 2 + COLOURS + SHAPES
WIDTH, HEADS, LAYERS = 128, 4, 2


class Objects(nn.Module):
    """Images (B, C, 96, 96) in [0, 1] to sets: elements (B, T, FEATURES), present ones (B, T)."""

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """The robot comes first, then blocks, then regions."""
        pixels = (images * 255).round().to(torch.uint8).permute(0, 2, 3, 1).cpu().numpy()
        newest = to_table(parse_frames(pixels[..., -CHANNELS:]))
        table = ObjectTable(*(each.to(images.device) for each in newest))
        before = torch.from_numpy(parse_frames(pixels[..., :CHANNELS], robot_alone=True).robot)
        robot, count = table.robot, table.size
        moved = robot - before.to(robot)
        turned = torch.atan2(moved[:, 2].sin(), moved[:, 2].cos())
        sin, cos = robot[:, 2].sin(), robot[:, 2].cos()
        pose = torch.cat(
            [
                robot[:, :2],
                torch.stack([sin, cos], 1),
                _to_robot(moved[:, None, :2], sin, cos)[:, 0],
                turned[:, None],
            ],
            dim=1,
        )
        places = [robot[:, None, :2], table.blocks, table.regions[..., :2]]
        others = [torch.zeros(count, n, 2).to(robot) for n in (1, table.blocks.shape[1])]
        absent = torch.full((count, 1), -1).to(table.colours)
        no_shape = torch.full_like(table.region_colours, -1)
        at = torch.cat(places, dim=1)
        sizes = torch.cat([*others, table.regions[..., 2:]], dim=1)
        colours = torch.cat([absent, table.colours, table.region_colours], dim=1)
        shapes = torch.cat([absent, table.shapes, no_shape], dim=1)
        kinds = [0] + [1] * table.blocks.shape[1] + [2] * table.regions.shape[1]
        kind = functional.one_hot(torch.tensor(kinds, device=robot.device), KINDS).float()
        every = at.shape[1]
        elements = torch.cat(
            [
                kind.expand(count, -1, -1),
                pose[:, None].expand(-1, every, -1),
                table.fingers[:, None].expand(-1, every, -1),
                at,
                _to_robot(at - robot[:, None, :2], sin, cos),
                sizes,
                _one_hot(colours, COLOURS),
                _one_hot(shapes, SHAPES),
            ],
            dim=2,
        )
        present = colours >= 0
        present[:, 0] = True
        return elements * present[..., None], present


class DeepSet(nn.Module):
    """Images to features (B, 2 WIDTH): mean and maximum of what one network makes of elements."""

    def __init__(self) -> None:
        super().__init__()
        self.objects = Objects()
        self.each = nn.Sequential(
            nn.Linear(FEATURES, WIDTH),
            nn.ReLU(),
            nn.Linear(WIDTH, WIDTH),
            nn.ReLU(),
            nn.Linear(WIDTH, WIDTH),
        )

    def forward(self, images: Tensor) -> Tensor:
        """See the class."""
        elements, present = self.objects(images)
        return _pooled(self.each(elements), present)


class SetTransformer(nn.Module):
    """The same with attention among the elements."""

    def __init__(self) -> None:
        super().__init__()
        self.objects = Objects()
        self.each = nn.Linear(FEATURES, WIDTH)
        layer = nn.TransformerEncoderLayer(
            WIDTH, HEADS, 2 * WIDTH, dropout=0.0, batch_first=True, norm_first=True
        )
        self.among = nn.TransformerEncoder(layer, LAYERS, enable_nested_tensor=False)

    def forward(self, images: Tensor) -> Tensor:
        """See the class."""
        elements, present = self.objects(images)
        return _pooled(self.among(self.each(elements), src_key_padding_mask=~present), present)


@dataclass(frozen=True)
class Architecture:
    """What `magical_baselines.networks` asks of an architecture."""

    network: type[nn.Module]
    HIDDEN: tuple[int, ...] = (256,)
    LEARNED_FROM: tuple[str, ...] = PARSER_SOURCES

    def make_convolutions(self, channels: int, batch_norm: bool) -> nn.Module:
        """The network; it has no batch norm."""
        return self.network()


DEEP_SET, SET_TRANSFORMER = Architecture(DeepSet), Architecture(SetTransformer)


def _to_robot(offsets: Tensor, sin: Tensor, cos: Tensor) -> Tensor:
    """Offsets (B, T, 2) in the workspace as (right, ahead) of the robot."""
    x, y = offsets.unbind(-1)
    sin, cos = sin[:, None], cos[:, None]
    return torch.stack([x * cos + y * sin, y * cos - x * sin], dim=-1)


def _one_hot(values: Tensor, number: int) -> Tensor:
    """One-hot (..., number); zeros where a value is absent."""
    return functional.one_hot(values + 1, number + 1)[..., 1:].float()


def _pooled(elements: Tensor, present: Tensor) -> Tensor:
    shown = present[..., None]
    mean = (elements * shown).sum(dim=1) / shown.sum(dim=1)
    largest = elements.masked_fill(~shown, -torch.inf).amax(dim=1)
    return torch.cat([mean, largest], dim=1)
