"""All environments in one image: a row for each task, a column for each variant."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from magical.envs import EnvId
from magical.envs.env import MagicalEnv
from magical.evaluation.variants import full_variant, short_variant
from magical.observe import PixelSpec
from magical.scene import View
from magical.tasks import TASKS, VARIANTS, get_task

Pixels = NDArray[np.uint8]  # (H, W, 3)

MARGIN = 8  # pixels between scenes
FONT_SIZE = 17
DASH = 6  # pixels, half its length
INK, FAINT, PAPER = "#26262b", "#a0a0a8", "#ffffff"


def contact_sheet(
    tasks: Sequence[str] | None = None,
    variants: Sequence[str] | None = None,
    *,
    seed: int = 0,
    size: int = 152,
    view: View = View.ALLO,
) -> Pixels:
    """Render the initial scene of every variant of every task, labelled.

    A scene is the one that `gymnasium.make(id).reset(seed=seed)` starts from. The allocentric view
    shows all of it. A dash stands where a task lacks the variant.

    Args:
        tasks: names of tasks, all by default.
        variants: names of variants (short ones will do), all by default.
        seed: which scenes are sampled.
        size: pixels across a scene.
        view: the camera.

    Raises:
        UnknownNameError: an unknown task or variant.
    """
    chosen_tasks = [get_task(name) for name in (tasks or TASKS)]
    columns = [full_variant(name) for name in (variants or VARIANTS)]
    font = ImageFont.load_default(FONT_SIZE)
    left = MARGIN * 2 + round(max(font.getlength(task.name) for task in chosen_tasks))
    top, pitch = MARGIN * 2 + FONT_SIZE, size + MARGIN
    sheet = Image.new("RGB", (left + pitch * len(columns), top + pitch * len(chosen_tasks)), PAPER)
    pen = ImageDraw.Draw(sheet)
    for column, variant in enumerate(columns):
        middle = (left + pitch * column + size / 2, top / 2)
        pen.text(middle, short_variant(variant), INK, font, anchor="mm")
    for row, task in enumerate(chosen_tasks):
        y = top + pitch * row
        pen.text((left - MARGIN, y + size / 2), task.name, INK, font, anchor="rm")
        for column, variant in enumerate(columns):
            x = left + pitch * column
            if variant in task.variants:
                scene = first_frame(EnvId(task.name, variant), seed, size, view)
                sheet.paste(Image.fromarray(scene), (x, y))
            else:
                middle = (x + size / 2, y + size / 2)
                pen.line((middle[0] - DASH, middle[1], middle[0] + DASH, middle[1]), FAINT, 2)
    return np.asarray(sheet)


def first_frame(env_id: EnvId, seed: int, size: int, view: View = View.ALLO) -> Pixels:
    """The scene an environment starts from with a seed, `size` pixels across."""
    spec = PixelSpec(((view, 1),), size=size)
    env = MagicalEnv(env_id.task, env_id.variant, observation=spec)
    frame: Pixels = env.reset(seed=seed)[0]
    env.close()
    return frame
