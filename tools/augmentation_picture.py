"""Write docs/images/augmentations.png: each augmentation of a frame, and all together.

python tools/augmentation_picture.py
"""

from pathlib import Path

import gymnasium
import numpy as np
import torch
from PIL import Image, ImageDraw

import magical  # noqa: F401  (registers the environments)
from magical_baselines.augmentation.augment import augment
from magical_baselines.augmentation.names import NAMES, SETS, Augmentations, parse_augmentations

PICTURE = Path(__file__).resolve().parents[1] / "docs" / "images" / "augmentations.png"
SAMPLES = 4  # examples of each
TILE, GAP, LABEL = 144, 8, 110  # pixels


def rows() -> dict[str, Augmentations]:
    """The augmentations shown: none, each one alone, all."""
    alone = {name: parse_augmentations(name) for name in NAMES}
    return {"original": SETS["none"], **alone, "all": SETS["all"]}


def augmentations() -> Image.Image:
    """Each augmentation alone, and all together."""
    env = gymnasium.make("magical/MatchRegions-Demo-LoRes4E-v0")
    stack, _ = env.reset(seed=0)
    images = torch.from_numpy(np.tile(stack.transpose(2, 0, 1), (SAMPLES, 1, 1, 1)))
    rng = np.random.default_rng
    shown = {name: augment(images, which, rng(1)) for name, which in rows().items()}
    return table(shown)


def table(shown: dict[str, torch.Tensor]) -> Image.Image:
    """The newest frames of stacks (B, C, H, W), with a row for each name."""
    columns = len(next(iter(shown.values())))
    size = (LABEL + columns * (TILE + GAP), len(shown) * (TILE + GAP))
    picture = Image.new("RGB", size, "white")
    draw = ImageDraw.Draw(picture)
    for row, (name, changed) in enumerate(shown.items()):
        top = row * (TILE + GAP)
        draw.text((GAP, top + TILE // 2), name, fill="black", font_size=16)
        newest = (changed[:, -3:].permute(0, 2, 3, 1) * 255).round().byte().numpy()
        for column, frame in enumerate(newest):
            image = Image.fromarray(frame).resize((TILE, TILE), Image.Resampling.NEAREST)
            picture.paste(image, (LABEL + column * (TILE + GAP), top))
    return picture


def main() -> None:
    PICTURE.parent.mkdir(parents=True, exist_ok=True)
    augmentations().save(PICTURE, optimize=True)
    print(f"wrote {PICTURE}")


if __name__ == "__main__":
    main()
