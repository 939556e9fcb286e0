"""Comparison of sampled scenes with recorded ones: distributions and rules."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from magical.envs import parse_env_id
from magical.evaluation import published_tasks
from magical.scene import Poses
from magical.tasks import TASKS, get_task, placement
from tests.reference import scenes
from tests.reference.recordings import DATA, scene_of
from tests.tasks.placement_rules import check_placement, enclosed_blocks

RECORDED_ROUNDING = 3e-5  # units and rad: five decimals, of several coordinates together
Recorded = dict[str, list[scenes.SceneRow]]


@pytest.fixture(scope="module")
def recorded() -> Recorded:
    return scenes.load(DATA / "scenes.json.gz")


def test_every_published_environment_is_recorded(recorded: Recorded) -> None:
    expected = {f"{name}-{v}-v0" for name in published_tasks() for v in TASKS[name].variants}
    assert set(recorded) == expected


def test_recorded_scenes_keep_the_rules(recorded: Recorded) -> None:
    for env, rows in recorded.items():
        env_id = parse_env_id(env)
        for row in rows[::4]:
            check_placement(get_task(env_id.task), env_id.variant, scene_of(row), RECORDED_ROUNDING)


@pytest.mark.parametrize("name", ["FindDupe", "FixColour"])
def test_recorded_enclosed_blocks_reach_the_limit(name: str, recorded: Recorded) -> None:
    task, left = get_task(name), []
    for row in recorded[f"{name}-TestLayout-v0"]:
        scene = scene_of(row)
        for i, r in enclosed_blocks(task, len(scene.blocks), len(scene.regions)).items():
            (x, y), block = scene.regions[r].centre, scene.blocks[i].pose
            furthest = max(abs(block.x - x), abs(block.y - y))
            left.append(task.placement.limit(scene.regions[r]) - furthest)
    assert -RECORDED_ROUNDING < min(left) < 0.01


def test_demo_scenes_are_the_recorded_ones(recorded: Recorded) -> None:
    for name in published_tasks():
        pair = get_task(name).demo, scene_of(recorded[f"{name}-Demo-v0"][0])
        demo, found = ([(b.shape, b.colour) for b in scene.blocks] for scene in pair)
        assert demo == found
        bodies = [Poses.at_rest(scene).bodies for scene in pair]
        np.testing.assert_allclose(bodies[0], bodies[1], rtol=0, atol=1e-5)
        sides = [[(r.x, r.y, r.height, r.width) for r in scene.regions] for scene in pair]
        np.testing.assert_allclose(sides[0], sides[1], rtol=0, atol=1e-5)


def passed(recorded: Recorded, env: str) -> bool:
    data = {env: recorded[env]}
    found = scenes.compare(data, scenes.compute(data, samples=400))
    return all(comparison.passed for comparison in found)


WRONG: dict[str, tuple[str, float | tuple[float, float], str]] = {
    "jitter": ("POSITION_JITTER", 0.04, "MakeLine-TestJitter-v0"),
    "angles": ("ANGLE_JITTER", 0.25, "MoveToRegion-TestJitter-v0"),
    "sizes": ("SIZE_JITTER", 0.013, "FindDupe-TestJitter-v0"),
    "layout": ("WORKSPACE_HALF", 0.55, "MakeLine-TestLayout-v0"),
}


@pytest.mark.parametrize(("constant", "value", "env"), WRONG.values(), ids=WRONG)
def test_wrong_ranges_are_detected(
    constant: str, value: float, env: str, recorded: Recorded, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert passed(recorded, env)
    monkeypatch.setattr(placement, constant, value)
    assert not passed(recorded, env)


def test_wrong_categories_and_constants_are_detected(recorded: Recorded) -> None:
    env = "MakeLine-TestColour-v0"
    data = {env: recorded[env]}
    sampled = scenes.compute(data, samples=200)
    (comparison,) = scenes.compare(data, sampled)
    assert comparison.passed
    changes: tuple[Callable[[scenes.SceneRow], dict[str, Any]], ...] = (
        lambda row: {"blocks": [[b[0], "red", *b[2:]] for b in row["blocks"]]},
        lambda row: {"blocks": [["star", *b[1:]] for b in row["blocks"]]},
        lambda row: {"robot": [0.7021, *row["robot"][1:]]},
        lambda row: {"dynamics": [3.1, 1.0, 4.0, 1.5, 0.1]},
    )
    for change in changes:
        changed = [{**row, **change(row)} for row in sampled[env]]
        (comparison,) = scenes.compare(data, {env: changed})
        assert not comparison.passed
