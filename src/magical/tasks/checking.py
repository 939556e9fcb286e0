"""Whether a scene keeps the placement rules of a variant (details.md, section 8).

The counterpart of `placement`, written against the rules and not against the sampler.
"""

from collections.abc import Iterator, Sequence
from itertools import combinations, product
from math import pi

from magical.errors import InvalidSceneError
from magical.scene import Pose, Scene
from magical.scene.solids import Solid
from magical.tasks import validation as v
from magical.tasks.axes import Axis
from magical.tasks.placement import ANGLE_JITTER, POSITION_JITTER, SIZE_JITTER
from magical.tasks.task import Task

_Pair = tuple[tuple[str, Solid], tuple[str, Solid]]


def check_placement(task: Task, variant: str, scene: Scene) -> None:
    """Raise `InvalidSceneError` where the scene breaks a placement rule of the task's variant."""
    task.validate(scene)
    axes = task.axes_of(variant)
    if Axis.COUNT not in axes:
        _check_counts(task, scene)
    if axes & (Axis.JITTER | Axis.LAYOUT):
        v.check_inside({**v.named_bodies(scene), **v.named_regions(scene)}, v.ROUNDING)
        v.check_apart(_kept_apart(task, scene), v.ROUNDING)
        _check_sizes(task, scene)
        _check_enclosed(task, axes, scene)
    if Axis.LAYOUT in axes:
        angles = [scene.robot.angle, *(block.pose.angle for block in scene.blocks)]
        _expect("angles", [-pi], angles, [pi])
    else:
        _check_near_demo(task, axes, scene)


def _kept_apart(task: Task, scene: Scene) -> Iterator[_Pair]:
    bodies, regions = list(v.named_bodies(scene).items()), list(v.named_regions(scene).items())
    enclosed = {i + 1: r for i, r in task.placing.enclosed(len(scene.blocks)).items()}
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


def _check_sizes(task: Task, scene: Scene) -> None:
    low, high = task.placing.region_size
    for region in scene.regions:
        _expect("region size", [low], [region.height, region.width], [high])


def _check_enclosed(task: Task, axes: Axis, scene: Scene) -> None:
    for i, r in task.placing.enclosed(len(scene.blocks)).items():
        (x, y), pose = scene.regions[r].centre, scene.blocks[i].pose
        limit = task.placing.limit(scene.regions[r])
        if Axis.JITTER in axes:
            limit = min(limit, POSITION_JITTER)
        _expect(f"block {i} in region {r}", [-limit], [pose.x - x, pose.y - y], [limit])


def _check_near_demo(task: Task, axes: Axis, scene: Scene) -> None:
    jitter = float(Axis.JITTER in axes)
    enclosed = task.placing.enclosed(len(scene.blocks)) if jitter else {}
    _near("the robot", task.demo.robot, scene.robot, jitter)
    for i, (demo, block) in enumerate(zip(task.demo.blocks, scene.blocks, strict=True)):
        expected = demo.pose
        if i in enclosed:
            expected = Pose(block.pose.x, block.pose.y, demo.pose.angle)
        _near(f"block {i}", expected, block.pose, jitter)
    for old, new in zip(task.demo.regions, scene.regions, strict=True):
        _near("region", Pose(old.x, old.y, 0.0), Pose(new.x, new.y, 0.0), jitter)
        sizes = [new.height - old.height, new.width - old.width]
        _expect("region size", [-jitter * SIZE_JITTER], sizes, [jitter * SIZE_JITTER])


def _near(what: str, demo: Pose, pose: Pose, jitter: float) -> None:
    limits = [jitter * POSITION_JITTER, jitter * POSITION_JITTER, jitter * ANGLE_JITTER]
    change = [new - old for old, new in zip(demo, pose, strict=True)]
    _expect(f"{what}'s change from Demo", [-limit for limit in limits], change, limits)


def _expect(
    what: str, low: Sequence[float], values: Sequence[float], high: Sequence[float]
) -> None:
    lows, highs = (list(b) * (len(values) // len(b)) for b in (low, high))
    for least, value, most in zip(lows, values, highs, strict=True):
        if not least - v.ROUNDING <= value <= most + v.ROUNDING:
            raise InvalidSceneError(f"{what}: expected {least:g} to {most:g}, found {value:g}")
