"""Tasks and scenes in words, from task docstrings and scene contents."""

import inspect
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import ModuleType

import magical.tasks
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
    variation: Mapping[str, str]  # what each axis changes, by name


def describe_task(task: Task) -> Description:
    """The scoring rule of one of our tasks and how its variants vary the scene.

    Both are read from the docstring of the task's module: the scoring rule before `Horizon:`, the
    variation in the list after it.
    """
    modules = (m for m in vars(magical.tasks).values() if isinstance(m, ModuleType))
    module = next(module for module in modules if getattr(module, "TASK", None) is task)
    _, *paragraphs = (inspect.getdoc(module) or "").split("\n\n")
    horizon = next(i for i, text in enumerate(paragraphs) if text.startswith("Horizon: "))
    items = "\n".join(text for text in paragraphs[horizon:] if text.startswith("- "))
    pairs = (item.partition(": ") for item in re.split(r"^- ", items, flags=re.MULTILINE)[1:])
    return Description(
        [_paragraph(text) for text in paragraphs[:horizon]],
        {name: _paragraph(text).text for name, _, text in pairs},
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
