"""Checks of a scene against a variant's placement rules (docs/specification.md, section 8).

The counterpart of `magical.tasks.placement`, written from the rules and not from the sampler.
"""

from collections.abc import Sequence
from math import inf, pi

from magical.errors import InvalidSceneError
from magical.physics.overlap import Solids
from magical.scene import Pose, Scene
from magical.tasks import Axis, Task
from magical.tasks.placement import ANGLE_JITTER, POSITION_JITTER, ROUNDING, SIZE_JITTER


def check_placement(task: Task, variant: str, scene: Scene, slack: float = ROUNDING) -> None:
    """Raise `InvalidSceneError` for a scene that the task's variant may not start from.

    `slack` is in units and radians, for rounded coordinates as in recordings.
    """
    task.validate(scene)
    axes, demo = task.axes_of(variant), task.demo
    if Axis.COUNT not in axes:
        counts = [(len(s.blocks), len(s.regions)) for s in (demo, scene)]
        near("counts", counts[0], counts[1], (0, 0), 0.0)
    if axes & (Axis.JITTER | Axis.LAYOUT):
        check_apart(task, scene, slack)
        low, high = task.placement.region_size
        sizes = [size for region in scene.regions for size in (region.height, region.width)]
        middle, half = (low + high) / 2, (high - low) / 2
        near("sizes", [middle] * len(sizes), sizes, [half] * len(sizes), slack)
    jitter = POSITION_JITTER if Axis.JITTER in axes else inf
    enclosed = enclosed_blocks(task, len(scene.blocks), len(scene.regions))
    if axes & (Axis.JITTER | Axis.LAYOUT):
        for i, r in enclosed.items():
            limit = min(task.placement.limit(scene.regions[r]), jitter)
            block = scene.blocks[i].pose
            near("enclosed", scene.regions[r].centre, block[:2], (limit, limit), slack)
    if Axis.LAYOUT in axes:
        angles = [scene.robot.angle, *(block.pose.angle for block in scene.blocks)]
        near("angles", [0.0] * len(angles), angles, [pi] * len(angles), slack)
    else:
        check_near_demo(task, Axis.JITTER in axes, scene, slack)


def enclosed_blocks(task: Task, blocks: int, regions: int) -> dict[int, int]:
    """The blocks that start inside a region, and their regions."""
    return {blocks - regions + i: i for i in range(regions * task.placement.encloses)}


def check_apart(task: Task, scene: Scene, slack: float) -> None:
    solids = Solids.cleared()
    places = [(region, Pose(*region.centre, 0.0)) for region in scene.regions]
    bodies = [(None, scene.robot), *((block.shape, block.pose) for block in scene.blocks)]
    enclosed = enclosed_blocks(task, len(scene.blocks), len(scene.regions))
    allowed = {len(places) + 1 + i: r for i, r in enclosed.items()}
    placed = []
    for number, (kind, pose) in enumerate([*places, *bodies]):
        solid = solids.take(kind)
        solid.move(pose)
        if solid.beyond_wall > slack:
            raise InvalidSceneError(f"{kind} outside the workspace")
        for other, depth in solids.overlaps(solid):
            if depth > slack and placed.index(other) != allowed.get(number):
                raise InvalidSceneError(f"{kind} and {other.kind} overlap")
        solids.place(solid)
        placed.append(solid)


def check_near_demo(task: Task, jitter: bool, scene: Scene, slack: float) -> None:
    position, angle, size = (
        jitter * limit for limit in (POSITION_JITTER, ANGLE_JITTER, SIZE_JITTER)
    )
    limits = (position, position, angle)
    enclosed = enclosed_blocks(task, len(scene.blocks), len(scene.regions)) if jitter else {}
    near("the robot", task.demo.robot, scene.robot, limits, slack)
    for i, (old, new) in enumerate(zip(task.demo.blocks, scene.blocks, strict=True)):
        first = 2 if i in enclosed else 0  # an enclosed block's position follows its region instead
        near(f"block {i}", old.pose[first:], new.pose[first:], limits[first:], slack)
    for before, after in zip(task.demo.regions, scene.regions, strict=True):
        found = [(r.x, r.y, r.height, r.width) for r in (before, after)]
        near("the region", found[0], found[1], (position, position, size, size), slack)


def near(
    what: str,
    expected: Sequence[float],
    found: Sequence[float],
    limits: Sequence[float],
    slack: float,
) -> None:
    for centre, value, limit in zip(expected, found, limits, strict=True):
        if abs(value - centre) > limit + slack:
            raise InvalidSceneError(f"{what}: expected {centre:g} +- {limit:g}, found {value:g}")
