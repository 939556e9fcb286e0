"""The Gymnasium environment: its interface, actions, errors and options."""

import math
from dataclasses import replace
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import magical
from magical.envs.env import MagicalEnv
from magical.errors import (
    InvalidActionError,
    InvalidConfigError,
    InvalidSceneError,
    MagicalError,
    ResetNeededError,
    UnknownNameError,
)
from magical.observe import StateSpec
from magical.scene import ACTION_NAMES, Block, Colour, Dynamics, Pose, Scene, Shape
from magical.tasks import TASKS

CORNER = "magical/MoveToCorner-Demo-v0"
BLOCK = Block(Shape.STAR, Colour.RED, Pose(-0.7, 0.7, 0))


def make(task: str = "MoveToCorner", variant: str = "Demo", **options: Any) -> MagicalEnv:
    return MagicalEnv(task, variant, **{"observation": "state", **options})


def TO_CENTRE(task: Any) -> Any:
    """The potential for a task: minus the robot's distance to the centre."""
    return lambda scene, bodies: -math.hypot(*bodies[0, :2])


def test_episode_truncates_at_the_horizon_and_scores_there() -> None:
    env = make(reward="score", horizon=5)
    _, info = env.reset(seed=0)
    assert info.pop("instruction") == "Push the red square to the top left corner."
    assert info == {"eval_score": 0.0, "published_code_score": 0.0, "is_success": False}
    results = [env.step(0) for _ in range(5)]
    assert [result[2:4] for result in results] == [(False, False)] * 4 + [(False, True)]
    assert results[-1][1] == results[-1][4]["eval_score"] == env.scores().score


def test_gymnasium_s_time_limit_is_refused() -> None:
    """It would cut episodes off before they are scored."""
    expected = "max_episode_steps=10: .* expected horizon=10 instead"
    for env_id in (CORNER, "magical/MoveToCorner-Demo-LoRes4E-v0"):
        many = partial(gym.make_vec, env_id, 2, workers=1)
        for made in (partial(gym.make, env_id), gym.spec(env_id).make, many):
            with pytest.raises(InvalidConfigError, match=expected):
                made(max_episode_steps=10)
    assert gym.make(gym.make(CORNER, horizon=10).spec).unwrapped.horizon == 10


def test_rendering_without_a_render_mode_is_warned_of() -> None:
    with pytest.warns(UserWarning, match='with render_mode="rgb_array"'):
        assert make().render() is None


@pytest.mark.parametrize(("reward", "expected"), [("none", 0.0), ("score", 1.0)])
def test_rewards_of_a_solved_episode(reward: str, expected: float) -> None:
    env = make(horizon=1, reward=reward)
    env.reset(seed=0, options={"scene": Scene(Pose(0.5, 0, 0), (BLOCK,))})
    _, found, _, _, info = env.step(0)
    assert (found, info["eval_score"], info["is_success"]) == (expected, 1.0, True)


def test_rewards_of_a_potential_sum_to_its_increase() -> None:
    env = make(reward="tests.envs.test_env:TO_CENTRE")
    env.reset(seed=0)
    before = math.hypot(*env.state().poses.robot[:2])
    rewards = [env.step(1)[1] for _ in range(3)]
    assert sum(rewards) == pytest.approx(before - math.hypot(*env.state().poses.robot[:2]))
    assert any(rewards)


def test_the_published_horizon_differs_for_the_cluster_tasks_alone() -> None:
    for task in TASKS.values():
        published = 240 if task.name.startswith("Cluster") else task.horizon
        assert make(task.name, horizon="published").horizon == published


@pytest.mark.parametrize("share", [0.1, 1.0])
def test_speed_turning_and_grip_are_proportional(share: float) -> None:
    env = make(action_space="continuous")
    for action, speed, spin in (
        ([share, 0.0, 0.0], 0.8 * share, 0.0),
        ([-share, 0.0, 0.0], 0.6 * share, 0.0),
        ([0.0, share, 0.0], 0.0, 2.5 * share),
        ([0.0, -share, 0.0], 0.0, -2.5 * share),
    ):
        env.reset(seed=0)
        for _ in range(5):
            env.step(action)
        velocity = env.state().velocities[0]
        found = np.hypot(*velocity[:2]), velocity[2]
        assert found == pytest.approx((speed, spin), abs=1e-3)
    env.reset(seed=0)
    for _ in range(8):
        env.step([0.0, 0.0, 2 * share - 1])
    robot, left, right = env.state().poses.bodies[:3, 2]
    opening = np.pi / 8 * (1 - share)
    assert (left - robot, robot - right) == pytest.approx((opening, opening), abs=5e-3)


@pytest.mark.parametrize(
    ("kind", "action", "found"),
    [
        *(("discrete", action, "") for action in (-1, 1.0, "3", None, True, np.array([1, 2]))),
        ("discrete", 18, "found 18 in row 0"),
        ("continuous", [np.nan, 0.0, 0.0], "found drive nan in row 0"),
        ("continuous", np.array([0.0, 1.0 + 1e-9, 0.0]), "found turn 1"),
        *(("continuous", action, "") for action in ([0.0, 0.0], [0.0, [0.0], 0.0], 3, None)),
        *(("continuous", action, "") for action in (["0", "0", "0"], [True, False, True])),
    ],
)
def test_other_actions_are_refused_and_change_nothing(kind: Any, action: Any, found: str) -> None:
    env = make(action_space=kind)
    env.reset(seed=0)
    before = env.get_state()
    with pytest.raises(InvalidActionError, match=f"0 to 17.*{found}|-1 to 1.*{found}"):
        env.step(action)
    assert env.get_state() == before
    env.step(env.action_space.sample())


def test_order_of_calls() -> None:
    env = gym.make(CORNER, observation="state", horizon=1)
    for start in (lambda: None, lambda: (env.reset(seed=0), env.step(0))):
        start()
        with pytest.raises(ResetNeededError, match="reset"):
            env.step(0)


@pytest.mark.parametrize(
    ("env_id", "hint"),
    [
        ("magical/MoveToMars-Demo-v0", "MoveToCorner"),
        ("magical/MoveToCorner-TestLayout-v0", "TestJitter"),
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
        {"action_space": "box"},
        {"render_mode": "human"},
        *({"horizon": horizon} for horizon in (0, "long", 80.0, 10**20)),
    ],
)
def test_bad_construction(options: dict[str, Any]) -> None:
    with pytest.raises(MagicalError, match="expected"):
        make(**options)


def test_reset_from_a_scene_and_dynamics_as_dataclasses_or_dicts() -> None:
    scene, dynamics = Scene(Pose(0, 0, 0), (BLOCK,)), Dynamics(body_pivot_max_force=2.5)
    ends = []
    for options in (
        {"scene": scene, "dynamics": dynamics},
        {"scene": scene.to_dict(), "dynamics": dynamics.to_dict()},
        {"scene": scene},
    ):
        env = make()
        env.reset(seed=len(ends), options=options)
        ends.append([env.step(action)[0] for action in (1, 4, 13, 13)])
    assert np.array_equal(ends[0], ends[1])
    assert not np.array_equal(ends[0], ends[2])


@pytest.mark.parametrize(
    "options",
    [
        {"scene": {"robot": [0, 0, 0], "blocks": [["star", "red", 0.05, 0.1, 0]]}},
        {"scene": {"robot": [0, 0, 0], "blocks": [["star", "pink", 0.5, 0.5, 0]]}},
        {"scene": {"robot": [0, float("nan"), 0]}},
        {"scene": 5},
        {"colour": "red"},
        {3: 4, "b": 5},
        {"dynamics": 5},
        {"dynamics": {"gravity": 1.0}},
    ],
)
def test_impossible_starts(options: Any) -> None:
    env = make()
    with pytest.raises(MagicalError, match=r"expected|overlap|outside"):
        env.reset(seed=0, options=options)
    with pytest.raises(ResetNeededError):
        env.step(0)
    env.reset(seed=0)


def test_after_a_scene_that_cannot_be_shown_the_state_is_its_start() -> None:
    demo = TASKS["MatchRegions"].demo
    fewer = replace(demo, blocks=demo.blocks[1:])
    spec = StateSpec(len(fewer.blocks), len(fewer.regions))
    env = make("MatchRegions", observation=spec)
    env.reset(options={"scene": fewer})
    env.step(1)
    with pytest.raises(InvalidSceneError, match="expected at most"):
        env.reset()
    state = env.get_state()
    assert (state["scene"], state["actions"]) == (demo.to_dict(), [])


def test_action_names_and_keys() -> None:
    assert ACTION_NAMES[1 + 3 * 2 + 9] == "forward-right-closed"
    keys = make().get_keys_to_action()
    assert keys[("w", "a", " ")] == 1 + 3 * 1 + 9
    assert sorted(keys.values()) == list(range(1, 18))
    points = make(action_space="continuous").get_keys_to_action()
    assert points["w", "a", " "].tolist() == [1.0, 1.0, 1.0]
