"""Make the README's animation: every task's TestAll variant, solved by the scripted expert.

python tools/readme_picture.py
"""

from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

import magical
from magical.demos.generate import demonstrate
from magical.demos.trajectory import Frames
from magical.scene import View

OUT = Path(__file__).resolve().parents[1] / "docs" / "images" / "tasks.webp"
SIZE, GAP, CAPTION, COLUMNS = 176, 8, 22, 4  # pixels; tiles per row
FRAMES, MILLISECONDS, LAST = 48, 110, 1500  # frames per rollout; per frame and last frame, ms


def rollout(task: str) -> list[Image.Image]:
    """Frames from the first state to the last, in the allocentric view."""
    trajectory = demonstrate(f"magical/{task}-TestAll-v0", list(magical.TASKS).index(task))
    steps = np.linspace(0, len(trajectory), FRAMES).round().astype(int)
    frames = Frames(trajectory, View.ALLO, SIZE).take([int(step) for step in steps])
    return [Image.fromarray(frame) for frame in frames]


def main() -> None:
    step, tall = SIZE + GAP, SIZE + CAPTION
    rows = -(-len(magical.TASKS) // COLUMNS)
    sheets = [Image.new("RGB", (COLUMNS * step - GAP, rows * tall), "white") for _ in range(FRAMES)]
    font = ImageFont.load_default(size=14)
    for number, task in enumerate(magical.TASKS):
        left, top = number % COLUMNS * step, number // COLUMNS * tall
        for sheet, frame in zip(sheets, rollout(task), strict=True):
            middle = (left + SIZE // 2, top + CAPTION // 2)
            ImageDraw.Draw(sheet).text(middle, task, fill="black", font=font, anchor="mm")
            sheet.paste(frame, (left, top + CAPTION))
    OUT.parent.mkdir(parents=True, exist_ok=True)
    durations = [MILLISECONDS] * (FRAMES - 1) + [LAST]
    more = {"append_images": sheets[1:], "duration": durations, "loop": 0}
    sheets[0].save(OUT, "WEBP", save_all=True, lossless=True, quality=80, method=4, **more)


if __name__ == "__main__":
    main()
