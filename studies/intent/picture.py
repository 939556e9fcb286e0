"""A picture of beliefs about tasks: what would be moved first in Demo, and where to."""

import textwrap
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from magical.errors import UnknownNameError
from magical.files import write_atomically
from magical.render import render_frame
from magical.scene import Poses
from magical.tasks import get_task
from magical_goals.intent.acting import BORDER, CELLS, Intention
from magical_goals.intent.posterior import Belief
from magical_goals.objects.control import ROBOT_TARGET
from magical_goals.objects.parser import VIEW_HALF

COLUMNS = 4
SIZE, HEADING = 3.0, 0.5  # inches: the side of a scene, the height of its heading
PIXELS = 384
EXTENT = (-VIEW_HALF, VIEW_HALF, -VIEW_HALF, VIEW_HALF)  # units: left, right, bottom, top
FORMATS = ("jpg", "pdf", "png", "svg", "webp")
PLACES = (-BORDER, BORDER, -BORDER, BORDER)  # units: the same for the places


def draw_beliefs(beliefs: Mapping[str, Belief], path: Path) -> None:
    """Draw each task's Demo scene and the belief about the task.

    The number on a block, or on the robot, is the probability that it has to move. An arrow shows
    the first move; darker places are those that would leave less work.

    Raises:
        MissingDependencyError: the extra `report` is not installed.
        UnknownNameError: the suffix is not that of a picture.
    """
    from matplotlib.figure import Figure

    columns = min(COLUMNS, len(beliefs))
    rows = -(-len(beliefs) // columns)
    figure = Figure(figsize=(SIZE * columns, (SIZE + HEADING) * rows), layout="constrained")
    kind = path.suffix[1:].lower() or "png"
    if kind not in FORMATS:
        raise UnknownNameError(f"{path}: expected the suffix of a picture, such as .png or .svg")
    axes = list(figure.subplots(rows, columns, squeeze=False).flat)
    for axis in axes:
        axis.set_axis_off()
    for axis, (task, belief) in zip(axes, beliefs.items(), strict=False):
        _draw(axis, task, belief)
    with write_atomically(path) as file:
        figure.savefig(file, format=kind)


def _draw(axis: Any, task: str, belief: Belief) -> None:
    """Fill one task's panel."""
    scene = get_task(task).demo
    poses = Poses.at_rest(scene)
    intention = Intention(belief, scene)
    axis.imshow(render_frame(scene, poses, "allo", PIXELS), extent=EXTENT)
    program = repr(belief.explanations[0].program) if belief.is_explained else "no program"
    axis.set_title(f"{task}\n{textwrap.fill(program, 48)}", fontsize=8)
    if not intention.is_known:
        return
    centres = {block: tuple(xy) for block, xy in enumerate(poses.blocks[:, :2].tolist())}
    centres[ROBOT_TARGET] = poses.robot[:2]
    for thing, probability in intention.probabilities(poses).items():
        label = {"ha": "center", "va": "center", "fontsize": 8, "fontweight": "bold"}
        axis.text(*centres[thing], f"{probability:.2f}", **label)
    decision = intention.decide(poses)
    if decision is not None:
        thing, place = decision
        work = intention.work_at_places(thing, poses).reshape(CELLS, CELLS).T
        axis.imshow(work, extent=PLACES, origin="lower", cmap="gray", alpha=0.35)
        arrow = {"arrowstyle": "->", "linewidth": 2}
        axis.annotate("", xy=place, xytext=centres[thing], arrowprops=arrow)
    axis.set_xlim(EXTENT[:2])
    axis.set_ylim(EXTENT[2:])
