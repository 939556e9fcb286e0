"""Tasks and scenes in words."""

from collections import Counter
from dataclasses import dataclass

from magical.scene import Scene
from magical.tasks import CHANGES, Axis, Task


@dataclass(frozen=True, slots=True)
class Paragraph:
    """A paragraph of a scoring rule; an indented one is a formula."""

    text: str
    is_formula: bool = False


def scoring_rule(task: Task) -> list[Paragraph]:
    """A task's scoring rule."""
    return [_paragraph(text) for text in task.rule.split("\n\n")]


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
