"""Draw the Demo scenes of the first sixteen tasks of the suite with their instructions.

python -m studies.generated_tasks.picture
"""

import textwrap
from pathlib import Path

from PIL import Image, ImageDraw, ImageFont

from magical.render import render_frame
from magical.scene import Poses, View
from magical.tasks import get_task
from magical_goals.language.generated import SUITE, task_name

PICTURE = Path(__file__).with_name("scenes.png")
SIZE, TEXT, COLUMNS = 192, 62, 4  # pixels across a scene, below it for words; scenes in a row


def main() -> None:
    """Write `scenes.png` beside this file."""
    rows = 16 // COLUMNS
    sheet = Image.new("RGB", (COLUMNS * (SIZE + 12), rows * (SIZE + TEXT)), "white")
    pen, font = ImageDraw.Draw(sheet), ImageFont.load_default(11)
    for i, number in enumerate(SUITE[:16]):
        task = get_task(task_name(number))
        frame = render_frame(task.demo, Poses.at_rest(task.demo), View.ALLO, SIZE)
        x, y = i % COLUMNS * (SIZE + 12) + 6, i // COLUMNS * (SIZE + TEXT)
        sheet.paste(Image.fromarray(frame), (x, y))
        words = textwrap.fill(f"{number}: {task.instruction(task.demo)}", 34)
        pen.text((x, y + SIZE + 2), words, fill="black", font=font, spacing=1)
    sheet.save(PICTURE, optimize=True)


if __name__ == "__main__":
    main()
