"""Write three pictures of augmentations to docs/images.

- augmentations.png: each augmentation of a frame
- augment-by.png: the same augmentation of three frames, resampled and rendered
- transformations.png: each transformation of three frames

python tools/augmentation_picture.py
"""

from dataclasses import replace
from pathlib import Path

import gymnasium
import numpy as np
import torch
from PIL import Image, ImageDraw

import magical  # noqa: F401  (registers the environments)
from magical.demos.generate import demonstrate
from magical.observe import PRESETS
from magical_baselines.augmentation.augment import augment
from magical_baselines.augmentation.names import NAMES, SETS, Augmentations, parse_augmentations
from magical_baselines.augmentation.transformations import StackTransformations
from magical_baselines.data.expert_data import ExpertData
from magical_baselines.data.rendered_data import RenderedExpertData

IMAGES = Path(__file__).resolve().parents[1] / "docs" / "images"
SAMPLES = 4  # examples of each
CHOSEN = np.array([1, 20, 40])  # steps of a demonstration
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
    return table(shown, TILE)


def ways() -> Image.Image:
    """Resampled and rendered with the same random numbers; without noise, to show differences."""
    pairs = [("MatchRegions", demonstrate("magical/MatchRegions-Demo-v0", seed=0))]
    arguments = pairs, ["MatchRegions"], PRESETS["LoRes4E"]
    resampled, rendered = ExpertData(*arguments), RenderedExpertData(*arguments)
    which = parse_augmentations("translation+rotation+colour")
    shown = {
        name: data.augmented(CHOSEN, what, np.random.default_rng(4))
        for name, data, what in (
            ("original", resampled, SETS["none"]),
            ("resampled", resampled, which),
            ("rendered", rendered, which),
        )
    }
    return table(shown, 3 * TILE // 2)


def transformations() -> Image.Image:
    """Each transformation alone; not `frames`, which cannot be seen in the newest frame."""
    pairs = [("MatchRegions", demonstrate("magical/MatchRegions-Demo-v0", seed=0))]
    data = RenderedExpertData(pairs, ["MatchRegions"], PRESETS["LoRes4E"])
    count, yes = len(CHOSEN), np.ones(len(CHOSEN), bool)
    none = StackTransformations.none(count)
    changed = {
        "original": none,
        "palette": replace(none, palettes=np.array([7, 16, 23])),
        "mirror": replace(none, mirrored=yes),
        "walls": replace(none, without_walls=yes),
    }
    shown = {
        name: data.augmented(CHOSEN, SETS["none"], np.random.default_rng(0), transformed)
        for name, transformed in changed.items()
    }
    return table(shown, TILE)


def table(shown: dict[str, torch.Tensor], tile: int) -> Image.Image:
    """The newest frames of stacks (B, C, H, W), with a row for each name."""
    columns = len(next(iter(shown.values())))
    size = (LABEL + columns * (tile + GAP), len(shown) * (tile + GAP))
    picture = Image.new("RGB", size, "white")
    draw = ImageDraw.Draw(picture)
    for row, (name, changed) in enumerate(shown.items()):
        top = row * (tile + GAP)
        draw.text((GAP, top + tile // 2), name, fill="black", font_size=16)
        newest = (changed[:, -3:].permute(0, 2, 3, 1) * 255).round().byte().numpy()
        for column, frame in enumerate(newest):
            image = Image.fromarray(frame).resize((tile, tile), Image.Resampling.NEAREST)
            picture.paste(image, (LABEL + column * (tile + GAP), top))
    return picture


def main() -> None:
    """Write the pictures."""
    IMAGES.mkdir(parents=True, exist_ok=True)
    for name, make in (
        ("augmentations", augmentations),
        ("augment-by", ways),
        ("transformations", transformations),
    ):
        make().save(IMAGES / f"{name}.png", optimize=True)
        print(f"wrote {IMAGES / name}.png")


if __name__ == "__main__":
    main()
