"""Every task's variants and sampling, and the checks of a task's fields."""

from dataclasses import replace

import numpy as np
import pytest

from magical.errors import (
    InvalidSceneError,
    InvalidTaskError,
    UnknownNameError,
)
from magical.scene import Block, Colour, Dynamics, Pose, Poses, Scene, Shape
from magical.scene.scene import DYNAMICS_RANGES
from magical.tasks import TASKS, VARIANTS, Axis, Task
from magical.tasks.move_to_corner import TASK as MOVE_TO_CORNER

ALL_TASKS = pytest.mark.parametrize("task", TASKS.values(), ids=TASKS)
APPENDIX = [task for task in TASKS.values() if task.section]
ENVIRONMENTS = [(task, variant) for task in TASKS.values() for variant in task.variants]
ALL_VARIANTS = pytest.mark.parametrize(
    ("task", "variant"), ENVIRONMENTS, ids=lambda value: getattr(value, "name", value)
)
LACKING = {  # appendix, Table 2
    "MoveToCorner": {"TestLayout", "TestCountPlus"},
    "MoveToRegion": {"TestShape", "TestCountPlus"},
}


@pytest.mark.parametrize("task", APPENDIX, ids=lambda task: task.name)
def test_variants_are_those_of_the_appendix(task: Task) -> None:
    assert set(VARIANTS) - set(task.variants) == LACKING.get(task.name, set())


def test_the_appendix_has_sixty_environments() -> None:
    assert sum(len(task.variants) for task in APPENDIX) == 60


@pytest.mark.parametrize(
    ("name", "axes"),
    [
        ("MoveToCorner", Axis.JITTER | Axis.COLOUR | Axis.SHAPE | Axis.DYNAMICS),
        ("MoveToRegion", Axis.LAYOUT | Axis.COLOUR | Axis.DYNAMICS),
        ("MakeLine", VARIANTS["TestAll"]),
    ],
)
def test_all_varies_every_axis_of_the_task(name: str, axes: Axis) -> None:
    assert TASKS[name].axes_of("TestAll") == axes
    assert VARIANTS["TestAll"] == VARIANTS["TestCountPlus"] | Axis.DYNAMICS


@ALL_TASKS
def test_a_missing_variant_raises_with_the_available_ones(task: Task) -> None:
    for variant in set(VARIANTS) - set(task.variants):
        with pytest.raises(UnknownNameError) as error:
            task.sample(variant, np.random.default_rng(0))
        assert f"{task.name} has no variant '{variant}'" in str(error.value)
        assert ", ".join(task.variants) in str(error.value)
    with pytest.raises(UnknownNameError, match="did you mean 'TestColour'"):
        task.axes_of("TestColor")


@ALL_VARIANTS
def test_the_same_seed_samples_the_same_scene(task: Task, variant: str) -> None:
    first, again, other = (task.sample(variant, np.random.default_rng(s)) for s in (5, 5, 6))
    assert first == again
    assert (first != other) == (variant != "Demo")


@ALL_VARIANTS
def test_only_the_variants_axes_change(task: Task, variant: str) -> None:
    axes, demo = task.axes_of(variant), task.demo
    scenes = [task.sample(variant, np.random.default_rng(seed)) for seed in range(20)]
    moved = any(
        (s.robot, [b.pose for b in s.blocks]) != (demo.robot, [b.pose for b in demo.blocks])
        for s, _ in scenes
    )
    assert moved == bool(axes & (Axis.JITTER | Axis.LAYOUT))
    changed = any([b.shape for b in s.blocks] != [b.shape for b in demo.blocks] for s, _ in scenes)
    assert changed == (Axis.SHAPE in axes)
    colours = [b.colour for b in demo.blocks], [r.colour for r in demo.regions]
    changed = any(
        ([b.colour for b in s.blocks], [r.colour for r in s.regions]) != colours for s, _ in scenes
    )
    assert changed == (Axis.COLOUR in axes)
    assert {s.robot_first for s, _ in scenes} == {demo.robot_first}
    assert any(d != Dynamics() for _, d in scenes) == (Axis.DYNAMICS in axes)
    forces = np.array([[*d.to_dict().values()] for _, d in scenes])
    low, high = np.transpose(DYNAMICS_RANGES)
    assert ((low <= forces) & (forces <= high)).all()
    assert {len(s.blocks) for s, _ in scenes} == {len(demo.blocks)} or Axis.COUNT in axes


@ALL_TASKS
def test_the_maximum_counts_are_reached(task: Task) -> None:
    rng = np.random.default_rng(0)
    scenes = [task.sample("TestAll", rng)[0] for _ in range(300)]
    assert max(len(scene.blocks) for scene in scenes) == task.max_blocks
    assert max(len(scene.regions) for scene in scenes) == task.max_regions


@ALL_TASKS
def test_scores_are_floats_between_0_and_1(task: Task) -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        scene, _ = task.sample("TestAll", rng)
        final = Poses.at_rest(scene)
        final.bodies[5:, :2] = rng.uniform(-1, 1, (len(scene.blocks), 2))
        for value in (task.score(scene, final), task.published_code_score(scene, final)):
            assert type(value) is float
            assert 0.0 <= value <= 1.0


def test_poses_of_another_scene_are_rejected() -> None:
    task = TASKS["FindDupe"]
    with pytest.raises(InvalidSceneError, match="scene's 7 blocks, found 1"):
        task.score(task.demo, Poses.at_rest(MOVE_TO_CORNER.demo))


def test_too_many_blocks_are_rejected() -> None:
    blocks = [Block(Shape.CIRCLE, Colour.RED, Pose(x, -0.8, 0.0)) for x in (-0.8, 0.8)]
    with pytest.raises(InvalidSceneError, match="at most 0 blocks and 1 regions, found 2 and 0"):
        TASKS["MoveToRegion"].validate(Scene(Pose(0.0, 0.0, 0.0), tuple(blocks)))


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"name": "Move-To"}, "letters and digits"),
        ({"horizon": 0}, "positive horizon, found 0"),
        ({"published_horizon": -5}, "positive horizon, found -5"),
        ({"axes": Axis.COUNT | Axis.LAYOUT}, "for the axis COUNT"),
    ],
)
def test_contradictory_fields_are_rejected(fields: dict[str, object], message: str) -> None:
    with pytest.raises(InvalidTaskError, match=message):
        replace(MOVE_TO_CORNER, **fields)


def test_a_task_made_from_another_has_one_horizon() -> None:
    task = replace(MOVE_TO_CORNER, horizon=50)
    assert (task.resolve_horizon("published"), task.has_two_horizons) == (50, False)


def test_an_invalid_demo_scene_is_rejected() -> None:
    with pytest.raises(InvalidSceneError, match="expected 1 block"):
        replace(MOVE_TO_CORNER, demo=replace(MOVE_TO_CORNER.demo, blocks=()))
