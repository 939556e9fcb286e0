"""Make the README's picture: every task's Demo scene, and one of its TestAll scenes below.

python tools/readme_picture.py
"""

from pathlib import Path

import gymnasium
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

import magical

OUT = Path(__file__).resolve().parents[1] / "docs" / "images" / "tasks.png"
SIZE, GAP, CAPTION = 200, 8, 26  # pixels


def scene(task: str, variant: str) -> NDArray[np.uint8]:
    """A scene seen by the fixed camera, (SIZE, SIZE, 3)."""
    view = {"parts": (("allo", 1),), "size": SIZE, "samples": 4}
    env = gymnasium.make(f"magical/{task}-{variant}-v0", observation=view)
    pixels, _ = env.reset(seed=list(magical.TASKS).index(task))
    env.close()
    return np.asarray(pixels, dtype=np.uint8)


def main() -> None:
    """Make and write."""
    columns, rows = len(magical.TASKS), ("Demo", "TestAll")
    step = SIZE + GAP
    sheet = Image.new("RGB", (columns * step - GAP, CAPTION + len(rows) * step - GAP), "white")
    draw = ImageDraw.Draw(sheet)
    font = ImageFont.load_default(size=16)
    for column, task in enumerate(magical.TASKS):
        middle = (column * step + SIZE // 2, CAPTION // 2)
        draw.text(middle, task, fill="black", font=font, anchor="mm")
        for row, variant in enumerate(rows):
            place = (column * step, CAPTION + row * step)
            sheet.paste(Image.fromarray(scene(task, variant)), place)
    OUT.parent.mkdir(parents=True, exist_ok=True)
    sheet.quantize(256).save(OUT, optimize=True)


if __name__ == "__main__":
    main()
