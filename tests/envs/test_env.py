"""The Gymnasium environment: its interface, errors and options."""

import json
import math
from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import magical
from magical.envs.env import MagicalEnv, Potential
from magical.errors import (
    InvalidActionError,
    InvalidConfigError,
    InvalidSceneError,
    MagicalError,
    ResetNeededError,
    UnknownNameError,
)
from magical.observe import StateSpec
from magical.scene import ACTION_NAMES, Block, Colour, Dynamics, Pose, Poses, Scene, Shape
from magical.scene.poses import ROBOT
from magical.tasks import TASKS, Task

CORNER = "magical/MoveToCorner-Demo-v0"


def _make(env_id: str = CORNER, **options: Any) -> MagicalEnv:
    env = gym.make(env_id, **{"observation": "state", **options}).unwrapped
    assert isinstance(env, MagicalEnv)
    return env


def test_episode_truncates_at_the_horizon_and_scores_there() -> None:
    env = _make(reward="score", horizon=5)
    _, info = env.reset(seed=0)
    assert info.pop("instruction") == "Push the red square to the top left corner."
    assert info == {"eval_score": 0.0, "published_code_score": 0.0, "is_success": False}
    for step in range(5):
        _, reward, terminated, truncated, info = env.step(0)
        assert not terminated
        assert truncated == (step == 4)
    assert set(info) == {"eval_score", "published_code_score", "is_success"}
    assert reward == info["eval_score"] == env.scores().score


def test_gymnasium_s_time_limit_is_refused() -> None:
    """It would cut episodes off before they are scored."""
    expected = "max_episode_steps=10: .* expected horizon=10 instead"
    for env_id in (CORNER, "magical/MoveToCorner-Demo-LoRes4E-v0"):
        with pytest.raises(InvalidConfigError, match=expected):
            gym.make(env_id, max_episode_steps=10)
        with pytest.raises(InvalidConfigError, match=expected):
            gym.spec(env_id).make(max_episode_steps=10)
        with pytest.raises(InvalidConfigError, match=expected):
            gym.make_vec(env_id, 2, workers=1, max_episode_steps=10)
    env = _make(horizon=10)
    assert env.horizon == 10
    assert env.spec is not None
    again = gym.make(env.spec).unwrapped
    assert isinstance(again, MagicalEnv)
    assert again.horizon == 10


def test_rendering_without_a_render_mode_is_warned_of() -> None:
    with pytest.warns(UserWarning, match='with render_mode="rgb_array"'):
        assert _make().render() is None


def test_a_task_with_one_rule_is_scored_once(monkeypatch: pytest.MonkeyPatch) -> None:
    scored: list[Poses] = []

    def score(scene: Scene, poses: Poses) -> float:
        scored.append(poses)
        return 0.25

    env = _make(horizon=1)
    monkeypatch.setattr(env, "task", replace(env.task, score_fn=score))
    env.reset(seed=0)
    info = env.step(0)[4]
    assert (info["eval_score"], info["published_code_score"]) == (0.25, 0.25)
    assert len(scored) == 1


def test_default_reward_is_zero() -> None:
    scene = Scene(Pose(0.5, 0, 0), (Block(Shape.STAR, Colour.RED, Pose(-0.7, 0.7, 0)),))
    env = _make(horizon=1)
    env.reset(seed=0, options={"scene": scene})
    _, reward, _, _, info = env.step(0)
    assert (reward, info["eval_score"], info["is_success"]) == (0.0, 1.0, True)


def test_rewards_of_a_potential_sum_to_its_increase() -> None:
    env = _make(reward="tests.envs.potentials:TO_CENTRE")
    env.reset(seed=0)
    before = math.hypot(*env.state().poses.robot[:2])
    rewards = [env.step(1)[1] for _ in range(3)]
    assert sum(rewards) == pytest.approx(before - math.hypot(*env.state().poses.robot[:2]))
    assert any(rewards)


def test_a_reward_is_the_increase_of_a_potential_of_an_entry_point(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def forward(task: Task) -> Potential:
        return lambda scene, bodies: float(bodies[ROBOT, 1])

    monkeypatch.setattr("magical.envs.env.is_plugin", lambda group, name: name == "forward")
    monkeypatch.setattr("magical.envs.env.load_plugin", lambda group, name: forward)
    env = _make(reward="forward")
    env.reset(seed=0)
    before = env.state().poses.robot.y
    reward = env.step(1)[1]
    assert reward == env.state().poses.robot.y - before != 0.0


def test_instructions_name_what_the_variant_has() -> None:
    words = {_make("magical/FindDupe-TestAll-v0").reset(seed=i)[1]["instruction"] for i in range(5)}
    assert len(words) == 5


def test_horizons_are_the_appendix_s() -> None:
    horizons = {
        "MoveToCorner": 80, "MoveToRegion": 40, "MatchRegions": 120, "MakeLine": 180,
        "FindDupe": 100, "FixColour": 60, "ClusterColour": 320, "ClusterShape": 320,
    }  # fmt: skip
    made = {name: _make(f"magical/{name}-Demo-v0").horizon for name in horizons}
    assert made == horizons


def test_the_published_horizon_differs_for_the_cluster_tasks_alone() -> None:
    for task in TASKS.values():
        env = MagicalEnv(task.name, "Demo", observation="state", horizon="published")
        assert env.horizon == (240 if task.name.startswith("Cluster") else task.horizon)


@pytest.mark.parametrize("action", [-1, 18, 1.0, "3", None, True, np.array([1, 2]), np.float32(2)])
def test_bad_actions(action: Any) -> None:
    env = _make()
    env.reset(seed=0)
    with pytest.raises(InvalidActionError, match="0 to 17"):
        env.step(action)
    env.step(np.int64(3))  # still usable


def test_order_of_calls() -> None:
    env = gym.make(CORNER, observation="state", horizon=1)
    with pytest.raises(ResetNeededError, match="reset"):
        env.step(0)
    env.reset(seed=0)
    env.step(0)
    with pytest.raises(ResetNeededError, match="reset"):
        env.step(0)


@pytest.mark.parametrize(
    ("env_id", "hint"),
    [
        ("magical/MoveToMars-Demo-v0", "MoveToCorner"),
        ("magical/MoveToCorner-TestLayout-v0", "TestJitter"),
        ("magical/MoveToRegion-TestShape-v0", "TestLayout"),
        ("magical/MoveToCorner-Demo-LoRes9-v0", "LoRes4E"),
        ("MoveToCorner", "expected"),
        ("magical/MoveToCorner-Demo-v7", "expected"),
    ],
)
def test_unknown_ids(env_id: str, hint: str) -> None:
    with pytest.raises(UnknownNameError, match=hint):
        magical.parse_env_id(env_id)


@pytest.mark.parametrize(
    "options",
    [
        {"observation": "LoRes5"},
        {"reward": "lots"},
        *({"horizon": horizon} for horizon in (0, "long", 80.0, True, 10**20, [80], "8" * 5000)),
        *({"observation": {"size": size}} for size in (0, 96.5, "96", None, True, 10**9)),
        *({"observation": {"samples": samples}} for samples in (0, 1.5, True, 10**9)),
        *({"observation": {"parts": parts}} for parts in (5, [5], [["ego"]], [["ego", 0.5]])),
    ],
)
def test_bad_construction(options: dict[str, Any]) -> None:
    with pytest.raises(MagicalError, match="expected"):
        MagicalEnv("MoveToCorner", "Demo", **options)


def test_reset_from_a_scene_and_dynamics_as_dataclasses_or_dicts() -> None:
    scene = Scene(Pose(0, 0, 0), (Block(Shape.STAR, Colour.BLUE, Pose(0.5, 0.5, 1.0)),))
    dynamics = Dynamics(body_pivot_max_force=2.5)
    first, second = _make(), _make()
    start, _ = first.reset(seed=0, options={"scene": scene, "dynamics": dynamics})
    again, _ = second.reset(
        seed=1, options={"scene": scene.to_dict(), "dynamics": dynamics.to_dict()}
    )
    assert np.array_equal(start, again)
    for action in (1, 4, 13, 13):
        start, again = first.step(action)[0], second.step(action)[0]
    assert np.array_equal(start, again)
    default = _make()
    default.reset(seed=0, options={"scene": scene})
    for action in (1, 4, 13, 13):
        other = default.step(action)[0]
    assert not np.array_equal(start, other)


@pytest.mark.parametrize(
    "scene",
    [
        {"robot": [0, 0, 0], "blocks": [["star", "red", 0.05, 0.1, 0]]},
        {"robot": [0, 0, 0], "blocks": [["star", "red", 0.95, 0.5, 0]]},
        {"robot": [0, 0, 0], "blocks": [["star", "pink", 0.5, 0.5, 0]]},
        {"robot": [0, 0, 0], "blocks": [["cube", "red", 0.5, 0.5, 0]]},
        {"robot": [0, float("nan"), 0]},
        {"robot": [0, 0]},
        {"blocks": []},
        5,
        {"robot": [1e308, 0, 0], "blocks": [["star", "red", 0.5, 0.5, 0]]},
        {"robot": [0, 0, 0], "blocks": [["star", "red", 1e308, -1e308, 1e308]]},
        {"robot": [0, 0, 0], "blocks": [["star", "red", 0.5, 0.5, 0]] * 5000},
        {"robot": [0, 0, 0], "regions": [["red", -1e308, 1e308, 1e308, 1e308]]},
    ],
)
def test_impossible_scenes(scene: Any) -> None:
    env = _make(CORNER)
    with pytest.raises((InvalidSceneError, UnknownNameError)):
        env.reset(seed=0, options={"scene": scene})
    with pytest.raises(ResetNeededError):
        env.step(0)
    env.reset(seed=0)


def test_after_a_scene_that_cannot_be_shown_the_state_is_its_start() -> None:
    demo = TASKS["MatchRegions"].demo
    fewer = replace(demo, blocks=demo.blocks[1:])
    spec = StateSpec(len(fewer.blocks), len(fewer.regions))
    env = MagicalEnv("MatchRegions", "Demo", observation=spec)
    env.reset(options={"scene": fewer})
    env.step(1)
    with pytest.raises(InvalidSceneError, match="expected at most"):
        env.reset()
    state = env.get_state()
    assert (state["scene"], state["actions"]) == (demo.to_dict(), [])


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({"colour": "red"}, "reset options: expected .*scene"),
        ({3: 4, "b": 5}, "reset options: expected .*scene"),
        ({"dynamics": 5}, "dynamics: expected some of .*, found 5"),
        ({"dynamics": {"gravity": 1.0}}, "dynamics: expected some of"),
    ],
)
def test_impossible_reset_options(options: Any, expected: str) -> None:
    with pytest.raises(MagicalError, match=expected):
        _make().reset(options=options)


def test_action_names_and_keys() -> None:
    assert ACTION_NAMES[0] == "stop-straight-open"
    assert ACTION_NAMES[1 + 3 * 2 + 9] == "forward-right-closed"
    keys = _make().get_keys_to_action()
    assert keys[("w", "a", " ")] == 1 + 3 * 1 + 9
    assert sorted(keys.values()) == list(range(1, 18))


def test_state_keeps_the_random_generator() -> None:
    env, other = (_make("magical/MoveToCorner-TestJitter-v0") for _ in range(2))
    env.reset(seed=3)
    other.set_state(json.loads(json.dumps(env.get_state())))
    assert np.array_equal(env.reset()[0], other.reset()[0])
