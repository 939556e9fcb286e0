"""Tasks and scenes in words, from task docstrings and scene contents."""

import inspect
import re
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from magical.scene import Scene
from magical.tasks import CHANGES, Axis, Task


@dataclass(frozen=True, slots=True)
class Paragraph:
    """A paragraph of a docstring; an indented one is a formula."""

    text: str
    is_formula: bool = False


@dataclass(frozen=True, slots=True)
class Description:
    """A task's description from its docstring."""

    scoring_rule: Sequence[Paragraph]
    variation: Mapping[str, str] = field(default_factory=dict)  # what each axis changes, by name


def describe_task(task: Task) -> Description:
    """The scoring rule of a task and how its variants vary the scene.

    Both are read from the docstring of the module whose `TASK` this is, if the docstring begins
    with the task's name and is laid out like those of `magical.tasks`: the scoring rule before
    `Horizon:`, the variation in the list after it. Otherwise the scoring rule is the first
    paragraph of the docstring of the score function, or of the program's class if the program
    defines the score, and the variation is empty.
    """
    score_fn: Any = task.score_fn
    if isinstance(score_fn, partial):
        score_fn = score_fn.func
    if task.program is not None and score_fn == task.program.score:
        score_fn = task.program
    held = ((m, getattr(m, "__dict__", {})) for m in list(sys.modules.values()))
    doc = next((m.__doc__ for m, names in held if names.get("TASK") is task), None) or ""
    first, *paragraphs = inspect.cleandoc(doc).split("\n\n")
    horizon = [i for i, text in enumerate(paragraphs) if text.startswith("Horizon: ")]
    if not first.startswith(f"{task.name}: ") or not horizon:
        return Description([_paragraph((inspect.getdoc(score_fn) or "").split("\n\n")[0])])
    items = [text for text in paragraphs[horizon[0] :] if text.startswith("- ")]
    return Description(
        [_paragraph(text) for text in paragraphs[: horizon[0]]], _variation("\n".join(items))
    )


def describe_changes(task: Task, variant: str) -> str:
    """What a variant changes: the description of its only axis, or the names of its axes."""
    axes = [axis for axis in CHANGES if axis in task.axes_of(variant)]
    if not axes:
        return "the scene of the demonstrations"
    return CHANGES[axes[0]] if len(axes) == 1 else ", ".join(map(axis_name, axes))


def axis_name(axis: Axis) -> str:
    """The axis's name in lower case, such as `layout`."""
    return str(axis.name).lower()


def describe_scene(scene: Scene) -> str:
    """The contents of a scene, such as `a robot, 1 blue goal region, 2 red squares`."""
    kinds = [f"{region.colour} goal region" for region in scene.regions]
    kinds += [f"{block.colour} {block.shape}" for block in scene.blocks]
    counted = [f"{n} {kind}{'s' if n > 1 else ''}" for kind, n in Counter(kinds).items()]
    return ", ".join(["a robot", *counted])


def _paragraph(text: str) -> Paragraph:
    return Paragraph(" ".join(text.replace("`", "").split()), is_formula=text.startswith(" "))


def _variation(items: str) -> dict[str, str]:
    """The items of a Markdown list, by the text before each item's colon."""
    pairs = (item.partition(": ") for item in re.split(r"^- ", items, flags=re.MULTILINE)[1:])
    return {name: _paragraph(text).text for name, _, text in pairs}
