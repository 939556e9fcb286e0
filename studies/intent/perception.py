"""Learned perception: a small network that finds the objects of frames, trained on random scenes.

python -m studies.intent.perception train [--batches 7000] [--out FILE]

`FIND_OBJECTS` takes the place of the parser in `object-bc` and `program-bc`:

magical train program-bc --perception studies.intent.perception:FIND_OBJECTS --out RUN ...
magical --import studies.intent.perception evaluate RUN

The network says for every 4 x 4 pixels how likely they are an object's centre, where the centre is,
and what the object is (Zhou, Wang and Kraehenbuehl, "Objects as points", 2019). Its scenes have up
to ten blocks and three goal regions at uniformly random places. They know the palette, the shapes
and the robot, as the parser does, and no task.
"""

import argparse
import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from magical.render import Renderer
from magical.scene import COLOURS, EYES, FINGERS, SHAPES, Block, Pose, Poses, Region, Scene, View
from magical.scene.constants import BLOCK_SIZE, FINGER_OPEN, FRAME_SIZE, SIDES, WORKSPACE_HALF
from magical_goals.objects.parser import (
    ABSENT,
    FAR,
    MAX_BLOCKS,
    MAX_REGIONS,
    VIEW_HALF,
    ParsedFrames,
    Pixels,
)

WEIGHTS = Path(__file__).with_name("perception.pt")
STRIDE = 4  # pixels of a cell
CELLS = FRAME_SIZE // STRIDE
CELL = 2 * VIEW_HALF / CELLS  # units
WIDTH, DILATIONS = 48, (1, 2, 4, 1, 2, 1)
BATCH_SIZE = 64  # scenes
LEARNING_RATE = 3e-3  # the highest: it rises for a tenth of the batches, then falls to nearly 0

# The channels of each kind of object: centre, offset from the cell's centre, then its own.
ROBOT = 3 + 4  # cosine and sine of the angle, how far the fingers are open
BLOCK = 3 + len(COLOURS) + len(SHAPES)
REGION = 3 + 2 + len(COLOURS)  # half the width and the height
KINDS = [ROBOT, BLOCK, REGION]
NEAR = 1.2  # squared cells: the cells around a centre that know where it is
LIKELY = 0.2  # a centre that is found, where no neighbouring cell is likelier

Floats = NDArray[np.float64]


class Detector(nn.Module):
    """Frames (B, 3, 96, 96) in [0, 1] to the channels of all kinds, (B, 27, 24, 24)."""

    def __init__(self) -> None:
        super().__init__()
        self.stem = nn.Sequential(
            nn.Conv2d(3, 16, 5, 2, 2, bias=False),
            nn.BatchNorm2d(16),
            nn.ReLU(),
            nn.Conv2d(16, WIDTH, 3, 2, 1, bias=False),
            nn.BatchNorm2d(WIDTH),
            nn.ReLU(),
        )
        self.residuals = nn.ModuleList(
            nn.Sequential(
                nn.Conv2d(WIDTH, WIDTH, 3, 1, dilation, dilation, bias=False),
                nn.BatchNorm2d(WIDTH),
                nn.ReLU(),
            )
            for dilation in DILATIONS
        )
        self.head = nn.Conv2d(WIDTH, sum(KINDS), 1)

    def forward(self, frames: Tensor) -> Tensor:
        """The channels."""
        features: Tensor = self.stem(frames)
        for residual in self.residuals:
            features = features + residual(features)
        with torch.autocast(frames.device.type, enabled=False):  # places need float32
            channels: Tensor = self.head(features.float())
        return channels


class FindObjects:
    """What the parser does, by a trained network that is loaded when it is first needed."""

    def __init__(self, weights: Path) -> None:
        self._weights = weights
        self._detector: Detector | None = None

    def __call__(self, frames: Pixels, robot_alone: bool = False) -> ParsedFrames:
        """See `magical_goals.objects.parser`."""
        if self._detector is None:
            detector = Detector().eval()
            state = torch.load(self._weights, weights_only=True)
            detector.load_state_dict({name: value.float() for name, value in state.items()})
            self._detector = detector
        with torch.inference_mode(), torch.autocast("cpu", enabled=False):
            return decode(self._detector(to_images(frames)))


FIND_OBJECTS = FindObjects(WEIGHTS)


def to_images(frames: Pixels) -> Tensor:
    """Frames (B, 96, 96, 3) as floats (B, 3, 96, 96), channels last in memory."""
    pixels = torch.from_numpy(np.ascontiguousarray(frames))
    return pixels.permute(0, 3, 1, 2).float() / 255


def decode(channels: Tensor) -> ParsedFrames:
    """The objects of the channels of B frames."""
    robot, block, region = torch.split(channels, KINDS, dim=1)
    _, at, values = likeliest(robot, 1)
    angle = torch.atan2(values[:, 0, 1], values[:, 0, 0])
    found, blocks, scores = likeliest(block, MAX_BLOCKS)
    colours = scores[..., : len(COLOURS)].argmax(2)
    shapes = scores[..., len(COLOURS) :].argmax(2)
    found_regions, centres, sizes = likeliest(region, MAX_REGIONS)
    region_colours = sizes[..., 2:].argmax(2)
    rectangles = torch.cat([centres, sizes[..., :2]], 2)
    arrays: list[Any] = [
        torch.cat([at[:, 0], angle[:, None]], 1).double(),
        values[:, 0, 2:].double(),
        blocks.double().masked_fill(~found[..., None], FAR),
        colours.masked_fill(~found, ABSENT),
        shapes.masked_fill(~found, ABSENT),
        rectangles.double().masked_fill(~found_regions[..., None], 0.0),
        region_colours.masked_fill(~found_regions, ABSENT),
    ]
    return ParsedFrames(*(each.numpy() for each in arrays))


def likeliest(channels: Tensor, count: int) -> tuple[Tensor, Tensor, Tensor]:
    """The likeliest centres of a kind (B, C, 24, 24): found (B, count), places, other channels."""
    likely = channels[:, 0].sigmoid()
    peak = functional.max_pool2d(likely[:, None], 3, 1, 1)[:, 0] == likely
    scores, cells = (likely * peak).flatten(1).topk(count)
    picked = channels.flatten(2).transpose(1, 2).take_along_dim(cells[..., None], 1)
    rows, columns = cells // CELLS, cells % CELLS
    x = (columns + 0.5 + picked[..., 1]) * CELL - VIEW_HALF
    y = VIEW_HALF - (rows + 0.5 + picked[..., 2]) * CELL
    return scores > LIKELY, torch.stack([x, y], 2), picked[..., 3:]


class Sample(NamedTuple):
    """A random scene, its bodies, and how far the fingers are open."""

    scene: Scene
    bodies: Floats
    fingers: Floats  # (2,)


def random_sample(rng: np.random.Generator) -> Sample:
    """Sample robot, blocks without overlap, half the time one in the grip, and goal regions."""
    robot = _random_pose(rng.uniform(-0.8, 0.8, 2), rng)
    forward = np.array([-math.sin(robot.angle), math.cos(robot.angle)])
    centre, wanted = np.array(robot[:2]), rng.integers(MAX_BLOCKS + 1)
    places: list[Floats] = []
    if wanted and rng.random() < 0.5:
        places.append(centre + 0.3 * forward + rng.normal(0, 0.03, 2))
    for _ in range(60):
        place = rng.uniform(-0.9, 0.9, 2)
        if places and rng.random() < 0.3:  # beside another
            direction = rng.uniform(-math.pi, math.pi)
            reach = 2 * BLOCK_SIZE * rng.uniform(0.85, 1.2)
            place = places[-1] + reach * np.array([math.cos(direction), math.sin(direction)])
        free = all(np.linalg.norm(place - other) > 1.7 * BLOCK_SIZE for other in places)
        apart = np.linalg.norm(place - centre) > 0.28
        if len(places) < wanted and free and apart and np.abs(place).max() < WORKSPACE_HALF - 0.08:
            places.append(place)
    blocks = tuple(
        Block(rng.choice(SHAPES), rng.choice(COLOURS), _random_pose(place, rng)) for place in places
    )
    scene = Scene(robot, blocks, _random_regions(rng), bool(rng.integers(2)))
    bodies = Poses.at_rest(scene).bodies
    fingers = rng.uniform(-0.15, FINGER_OPEN + 0.05, 2)
    bodies[FINGERS, 2] = robot.angle - np.array(SIDES) * fingers
    bodies[EYES, 2] += rng.normal(0.0, 0.3)
    return Sample(scene, bodies, fingers)


def _random_pose(place: Floats, rng: np.random.Generator) -> Pose:
    return Pose(float(place[0]), float(place[1]), rng.uniform(-math.pi, math.pi))


def _random_regions(rng: np.random.Generator) -> tuple[Region, ...]:
    regions: list[Region] = []
    wanted = rng.integers(MAX_REGIONS + 1)
    for _ in range(20):
        width, height = rng.uniform(0.3, 0.9, 2)
        x, y = (rng.uniform(-1.0 + size / 2, 1.0 - size / 2) for size in (width, height))
        apart = all(
            abs(x - other.centre[0]) > (width + other.width) / 2
            or abs(y - other.centre[1]) > (height + other.height) / 2
            for other in regions
        )
        if apart and len(regions) < wanted:
            regions.append(Region.from_centre(rng.choice(COLOURS), x, y, height, width))
    return tuple(regions)


class Batch:
    """Rendered scenes, and what their cells should say."""

    def __init__(self, samples: list[Sample]) -> None:
        self.frames = np.empty((len(samples), FRAME_SIZE, FRAME_SIZE, 3), np.uint8)
        self.likely = torch.zeros(len(samples), len(KINDS), CELLS, CELLS)
        self.rows: list[list[tuple[int, int, int]]] = [[], [], []]  # sample, row, column
        self.values: list[list[list[float]]] = [[], [], []]
        for k, (scene, bodies, fingers) in enumerate(samples):
            Renderer(scene, View.ALLO, FRAME_SIZE).render(bodies, self.frames[k])
            x, y, angle = scene.robot
            self._add(k, 0, x, y, [math.cos(angle), math.sin(angle), *fingers])
            for each in scene.blocks:
                classes = [float(COLOURS.index(each.colour)), float(SHAPES.index(each.shape))]
                self._add(k, 1, each.pose.x, each.pose.y, classes)
            for area in scene.regions:
                sizes = [area.width / 2, area.height / 2, float(COLOURS.index(area.colour))]
                self._add(k, 2, *area.centre, sizes)

    def _add(self, sample: int, kind: int, x: float, y: float, values: list[float]) -> None:
        """Offsets and values are wanted in all cells around a centre."""
        column, row = (x + VIEW_HALF) / CELL - 0.5, (VIEW_HALF - y) / CELL - 0.5
        for i in range(max(round(row) - 1, 0), min(round(row) + 2, CELLS)):
            for j in range(max(round(column) - 1, 0), min(round(column) + 2, CELLS)):
                far = (row - i) ** 2 + (column - j) ** 2
                likely = max(float(self.likely[sample, kind, i, j]), math.exp(-2 * far))
                self.likely[sample, kind, i, j] = likely
                if far < NEAR:
                    self.rows[kind].append((sample, i, j))
                    self.values[kind].append([column - j, row - i, *values])


def losses(channels: Tensor, batch: Batch) -> dict[str, Tensor]:
    """Of centres, places and sizes (in cells, units and radians), colours and shapes."""
    parts = torch.split(channels, KINDS, dim=1)
    logits = torch.stack([part[:, 0] for part in parts], 1)
    centres = functional.binary_cross_entropy_with_logits(logits, batch.likely, reduction="sum")
    robot, block, region = (
        part[(rows := torch.tensor(places))[:, 0], 1:, rows[:, 1], rows[:, 2]]
        for part, places in zip(parts, batch.rows, strict=True)
    )
    of_robot, of_block, of_region = map(torch.tensor, batch.values)
    entropy, count = functional.cross_entropy, len(COLOURS)
    place = functional.l1_loss
    return {
        "centres": 0.1 * centres / len(channels),
        "robot": place(robot[:, :2], of_robot[:, :2]) + 3 * place(robot[:, 2:4], of_robot[:, 2:4]),
        "fingers": 3 * place(robot[:, 4:], of_robot[:, 4:]),
        "blocks": place(block[:, :2], of_block[:, :2]),
        "regions": place(region[:, :2], of_region[:, :2])
        + 10 * place(region[:, 2:4], of_region[:, 2:4]),
        "colours": entropy(block[:, 2 : 2 + count], of_block[:, 2].long())
        + entropy(region[:, 4:], of_region[:, 4].long()),
        "shapes": entropy(block[:, 2 + count :], of_block[:, 3].long()),
    }


def train(batches: int, out: Path) -> None:
    """Train a network on random scenes, for at least 11 batches, and write its weights."""
    torch.manual_seed(0)
    rng = np.random.default_rng(0)
    detector = Detector()
    optimizer = torch.optim.AdamW(detector.parameters(), LEARNING_RATE, weight_decay=1e-4)
    annealed = torch.optim.lr_scheduler.OneCycleLR(optimizer, LEARNING_RATE, batches, pct_start=0.1)
    means: dict[str, float] = {}
    for number in range(batches):
        batch = Batch([random_sample(rng) for _ in range(BATCH_SIZE)])
        with torch.autocast("cpu", torch.bfloat16):
            channels = detector(to_images(batch.frames))
        parts = losses(channels.float(), batch)
        optimizer.zero_grad()
        torch.autograd.backward(sum(parts.values(), torch.zeros(())))
        optimizer.step()
        annealed.step()
        for name, value in parts.items():
            means[name] = 0.99 * means.get(name, value.item()) + 0.01 * value.item()
        if (number + 1) % 100 == 0:
            print(number + 1, {name: round(mean, 4) for name, mean in means.items()}, flush=True)
        if (number + 1) % 500 == 0 or number + 1 == batches:
            torch.save({n: v.half() for n, v in detector.state_dict().items()}, out)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(dest="command", required=True)
    training = commands.add_parser("train")
    training.add_argument("--batches", type=int, default=7000)
    training.add_argument("--out", type=Path, default=WEIGHTS, help="default: what is in use")
    args = parser.parse_args()
    train(args.batches, args.out)


if __name__ == "__main__":
    main()
