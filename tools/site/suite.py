"""A page about the suite of generated tasks: pictures, instructions, programs, expert scores."""

import csv
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from magical.render import render_frame
from magical.scene import Poses, View
from magical.tasks import Task, get_task
from magical_goals.language.generated import HELD_OUT, TRAINING
from magical_goals.language.programs import program_of
from tools.readme_tables import table
from tools.site.previews import encoded

FOLDER = "suite"
EXPERT = Path("studies/generated_tasks/expert.csv")
SIZE = 96  # pixels across a picture
HEADER = ("Demo", "Task", "Instruction and program", "Expert, Demo", "Expert, TestAll")


def pages(root: Path) -> dict[str, str | bytes]:
    with (root / EXPERT).open() as file:
        scores = {f"Generated{row['number']:0>4}": row for row in csv.DictReader(file)}
    made: dict[str, str | bytes] = {f"{FOLDER}/index.md": page(scores)}
    for name in (*HELD_OUT, *TRAINING):
        made[f"{FOLDER}/{name}.webp"] = picture(get_task(name))
    return made


def page(scores: Mapping[str, Mapping[str, str]]) -> str:
    """The page: the held-out tasks, then the training tasks."""
    return (
        "# The suite of generated tasks\n\nDemo scenes with instructions and [programs]"
        "(../goals.md). The scores are means of 20 rollouts of the [scripted expert]"
        "(../studies/generated_tasks/README.md). Every task has all variants: "
        "`magical/Generated0004-TestAll-v0`.\n\n"
        f"## Held out: {len(HELD_OUT)} tasks\n\n{_table(HELD_OUT, scores)}\n\n"
        f"## For training: {len(TRAINING)} tasks\n\n{_table(TRAINING, scores)}\n"
    )


def _table(names: Sequence[str], scores: Mapping[str, Mapping[str, str]]) -> str:
    return table(HEADER, (list(_cells(name, scores[name])) for name in names))


def _cells(name: str, scores: Mapping[str, str]) -> Iterator[str]:
    task = get_task(name)
    yield f"![The Demo scene of {task.name}]({task.name}.webp)"
    yield task.name
    yield f"{task.instruction(task.demo)}<br>`{program_of(name)!r}`"
    for variant in ("Demo", "All"):
        yield f"{float(scores[variant]):.2f}"


def picture(task: Task) -> bytes:
    """A task's Demo scene as WebP."""
    frame = render_frame(task.demo, Poses.at_rest(task.demo), View.ALLO, SIZE)
    return encoded(frame, "WEBP", lossless=True)
