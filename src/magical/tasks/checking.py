"""Checks of a scene against a variant's placement rules (docs/specification.md, section 8).

The counterpart of `placement`, written from the rules and not from the sampler.
"""

from collections.abc import Iterator, Sequence
from itertools import combinations, product
from math import pi

from magical.errors import InvalidSceneError
from magical.scene import Scene
from magical.scene.solids import Solid
from magical.tasks import validation as v
from magical.tasks.axes import Axis
from magical.tasks.placement import ANGLE_JITTER, POSITION_JITTER, SIZE_JITTER
from magical.tasks.task import Task

_Pair = tuple[tuple[str, Solid], tuple[str, Solid]]


def check_placement(task: Task, variant: str, scene: Scene, slack: float = v.ROUNDING) -> None:
    """Check that a scene is one that the task's variant may start from.

    Args:
        task: the task.
        variant: one of its variants.
        scene: the scene to check.
        slack: tolerance in units and radians, for rounded coordinates as in recordings.

    Raises:
        InvalidSceneError: the scene breaks a placement rule.
        UnknownNameError: the task lacks the variant.
    """
    task.validate(scene)
    axes = task.axes_of(variant)
    if Axis.COUNT not in axes:
        _check_counts(task, scene)
    if axes & (Axis.JITTER | Axis.LAYOUT):
        v.check_inside({**v.named_bodies(scene), **v.named_regions(scene)}, slack)
        v.check_apart(_kept_apart(task, scene), slack)
        _check_sizes(task, scene, slack)
        _check_enclosed(task, axes, scene, slack)
    if Axis.LAYOUT in axes:
        angles = [scene.robot.angle, *(block.pose.angle for block in scene.blocks)]
        _near("angles", [0.0] * len(angles), angles, [pi] * len(angles), slack)
    else:
        _check_near_demo(task, axes, scene, slack)


def _kept_apart(task: Task, scene: Scene) -> Iterator[_Pair]:
    bodies, regions = list(v.named_bodies(scene).items()), list(v.named_regions(scene).items())
    enclosed = {i + 1: r for i, r in task.placement.enclosed(len(scene.blocks)).items()}
    yield from combinations(bodies, 2)
    yield from combinations(regions, 2)
    for (i, body), (j, region) in product(enumerate(bodies), enumerate(regions)):
        if enclosed.get(i) != j:
            yield body, region


def _check_counts(task: Task, scene: Scene) -> None:
    expected = len(task.demo.blocks), len(task.demo.regions)
    found = len(scene.blocks), len(scene.regions)
    if found != expected:
        raise InvalidSceneError(f"expected {expected} blocks and regions, found {found}")


def _check_sizes(task: Task, scene: Scene, slack: float) -> None:
    low, high = task.placement.region_size
    for size in (size for r in scene.regions for size in (r.height, r.width)):
        if not low - slack <= size <= high + slack:
            raise InvalidSceneError(f"region size: expected {low} to {high}, found {size:g}")


def _check_enclosed(task: Task, axes: Axis, scene: Scene, slack: float) -> None:
    for i, r in task.placement.enclosed(len(scene.blocks)).items():
        (x, y), pose = scene.regions[r].centre, scene.blocks[i].pose
        limit = task.placement.limit(scene.regions[r])
        if Axis.JITTER in axes:
            limit = min(limit, POSITION_JITTER)
        _near(f"block {i} in region {r}", (x, y), pose[:2], (limit, limit), slack)


def _check_near_demo(task: Task, axes: Axis, scene: Scene, slack: float) -> None:
    jitter = float(Axis.JITTER in axes)
    enclosed = task.placement.enclosed(len(scene.blocks)) if jitter else {}
    position, angle, size = (
        jitter * limit for limit in (POSITION_JITTER, ANGLE_JITTER, SIZE_JITTER)
    )
    limits = (position, position, angle)
    _near("the robot", task.demo.robot, scene.robot, limits, slack)
    for i, (old, new) in enumerate(zip(task.demo.blocks, scene.blocks, strict=True)):
        # An enclosed block's position follows its region instead.
        first = 2 if i in enclosed else 0
        _near(f"block {i}", old.pose[first:], new.pose[first:], limits[first:], slack)
    for before, after in zip(task.demo.regions, scene.regions, strict=True):
        expected = (before.x, before.y, before.height, before.width)
        found = (after.x, after.y, after.height, after.width)
        _near("the region", expected, found, (position, position, size, size), slack)


def _near(
    what: str,
    expected: Sequence[float],
    found: Sequence[float],
    limits: Sequence[float],
    slack: float,
) -> None:
    for centre, value, limit in zip(expected, found, limits, strict=True):
        if abs(value - centre) > limit + slack:
            raise InvalidSceneError(
                f"{what}: expected a coordinate at most {limit:g} from {centre:g}, found {value:g}"
            )
