"""Writes docs/images/augmentations.png: a frame, and what each augmentation makes of it.

python tools/augmentation_picture.py
"""

from pathlib import Path

import gymnasium
import numpy as np
import torch
from PIL import Image, ImageDraw

import magical  # noqa: F401  (registers the environments)
from magical.learning.augment import augment
from magical.learning.augmentations import NAMES, SETS, Augmentations, parse_augmentations

OUT = Path(__file__).resolve().parents[1] / "docs" / "images" / "augmentations.png"
SAMPLES = 4  # examples of each
TILE, GAP, LABEL = 144, 8, 110  # pixels


def rows() -> dict[str, Augmentations]:
    """What is shown: nothing, each alone, all."""
    alone = {name: parse_augmentations(name) for name in NAMES}
    return {"original": SETS["none"], **alone, "all": SETS["all"]}


def main() -> None:
    """Make the picture."""
    env = gymnasium.make("magical/MatchRegions-Demo-LoRes4E-v0")
    stack, _ = env.reset(seed=0)
    images = torch.from_numpy(np.tile(stack.transpose(2, 0, 1), (SAMPLES, 1, 1, 1)))
    shown = rows()
    size = (LABEL + SAMPLES * (TILE + GAP), len(shown) * (TILE + GAP))
    picture = Image.new("RGB", size, "white")
    draw = ImageDraw.Draw(picture)
    for row, (name, which) in enumerate(shown.items()):
        top = row * (TILE + GAP)
        draw.text((GAP, top + TILE // 2), name, fill="black", font_size=16)
        changed = augment(images, which, np.random.default_rng(1))
        newest = (changed[:, -3:].permute(0, 2, 3, 1) * 255).round().byte().numpy()
        for column, frame in enumerate(newest):
            tile = Image.fromarray(frame).resize((TILE, TILE), Image.Resampling.NEAREST)
            picture.paste(tile, (LABEL + column * (TILE + GAP), top))
    OUT.parent.mkdir(parents=True, exist_ok=True)
    picture.save(OUT, optimize=True)
    print(f"wrote {OUT}")


if __name__ == "__main__":
    main()
