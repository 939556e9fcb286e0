"""A page about the suite of generated tasks: pictures, instructions, programs, expert scores."""

import csv
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from magical.render import render_frame
from magical.scene import Poses, View
from magical.tasks import Task, get_task
from magical.tasks.programs.suite import HELD_OUT, TRAINING, task_name
from tools.readme_tables import table
from tools.site.previews import encoded

FOLDER = "suite"
EXPERT = Path("studies/generated_tasks/expert.csv")
SIZE = 96  # pixels across a picture
HEADER = ("Demo", "Task", "Instruction and program", "Expert, Demo", "Expert, TestAll")


def pages(root: Path) -> dict[str, str | bytes]:
    """The page and the pictures, by path in the site."""
    with (root / EXPERT).open() as file:
        scores = {int(row["number"]): row for row in csv.DictReader(file)}
    made: dict[str, str | bytes] = {f"{FOLDER}/index.md": page(scores)}
    for number in (*HELD_OUT, *TRAINING):
        name = task_name(number)
        made[f"{FOLDER}/{name}.webp"] = picture(get_task(name))
    return made


def page(scores: Mapping[int, Mapping[str, str]]) -> str:
    """The page: the held-out tasks, then the training tasks."""
    return (
        "# The suite of generated tasks\n\nDemo scenes with instructions and [programs]"
        "(../programs.md). The scores are means of 20 rollouts of the [scripted expert]"
        "(../studies/generated_tasks/README.md). Every task has all variants: "
        "`magical/Generated0004-TestAll-v0`.\n\n"
        f"## Held out: {len(HELD_OUT)} tasks\n\n{_table(HELD_OUT, scores)}\n\n"
        f"## For training: {len(TRAINING)} tasks\n\n{_table(TRAINING, scores)}\n"
    )


def _table(numbers: Sequence[int], scores: Mapping[int, Mapping[str, str]]) -> str:
    return table(HEADER, (list(_cells(number, scores[number])) for number in numbers))


def _cells(number: int, scores: Mapping[str, str]) -> Iterator[str]:
    task = get_task(task_name(number))
    yield f"![The Demo scene of {task.name}]({task.name}.webp)"
    yield task.name
    yield f"{task.instruction(task.demo)}<br>`{task.program!r}`"
    for variant in ("Demo", "All"):
        yield f"{float(scores[variant]):.2f}"


def picture(task: Task) -> bytes:
    """A task's Demo scene as WebP."""
    frame = render_frame(task.demo, Poses.at_rest(task.demo), View.ALLO, SIZE)
    return encoded(frame, "WEBP", lossless=True)
