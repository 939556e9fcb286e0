"""Vector environments: equal to single ones, Gymnasium's interface, saved states, threads."""

import re
import subprocess
import sys
import threading
from copy import deepcopy
from dataclasses import replace
from functools import partial
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from magical.envs import EnvId
from magical.envs.env import MagicalEnv
from magical.envs.ids import parse_env_id
from magical.envs.vector import MagicalVectorEnv
from magical.errors import (
    InvalidActionError,
    InvalidScoreError,
    InvalidStateError,
    MismatchedSpacesError,
    ResetNeededError,
    UnknownNameError,
)
from magical.observe.spec import copy_arrays
from magical.scene import Block, Colour, Dynamics, Pose, Scene, Shape
from magical.scene.actions import NUM_ACTIONS
from magical.tasks import get_task, register_task, unregister_task

MIXED = (
    "magical/FindDupe-TestAll-v0",
    "magical/FindDupe-Demo-v0",
    "magical/FindDupe-TestDynamics-v0",
)


def vector(
    env_ids: Any = MIXED, workers: int = 1, observation: Any = "state", **options: Any
) -> MagicalVectorEnv:
    return MagicalVectorEnv(env_ids, workers=workers, observation=observation, **options)


HORIZON = 7

TO_CENTRE = "tests.envs.potentials:TO_CENTRE"


def single(env_id: str, observation: Any = "state", **options: Any) -> MagicalEnv:
    parsed = parse_env_id(env_id)
    return MagicalEnv(parsed.task, parsed.variant, observation=observation, **options)


def actions_for(num_envs: int, steps: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, NUM_ACTIONS, (steps, num_envs))


def same(found: Any, expected: Any) -> None:
    """Hold nested results to equality in values, types and shapes."""
    assert type(found) is type(expected)
    if isinstance(expected, dict):
        assert found.keys() == expected.keys()
        for key in expected:
            same(found[key], expected[key])
    elif isinstance(expected, (tuple, list)):
        assert len(found) == len(expected)
        for one, other in zip(found, expected, strict=True):
            same(one, other)
    elif isinstance(expected, np.ndarray) and expected.dtype == object:
        same(found.tolist(), expected.tolist())
    elif isinstance(expected, np.ndarray):
        assert found.dtype == expected.dtype
        np.testing.assert_array_equal(found, expected)
    else:
        assert found == expected


@pytest.mark.parametrize("num_envs", [1, 2, 16])
@pytest.mark.parametrize("workers", [1, 3])
def test_sub_environments_are_bit_equal_to_single_environments(num_envs: int, workers: int) -> None:
    env_ids = [MIXED[i % len(MIXED)] for i in range(num_envs)]
    steps = actions_for(num_envs, 2 * HORIZON + 3)
    envs = vector(env_ids, workers, horizon=HORIZON)
    singles = [single(env_id, horizon=HORIZON) for env_id in env_ids]
    observations, _ = envs.reset(seed=3)
    expected = [env.reset(seed=3 + i)[0] for i, env in enumerate(singles)]
    np.testing.assert_array_equal(observations, np.stack(expected))
    for step, actions in enumerate(steps):
        observations, _, _, truncated, infos = envs.step(actions)
        if step % (HORIZON + 1) == HORIZON:
            expected = [env.reset()[0] for env in singles]
            assert not truncated.any()
        else:
            results = [env.step(a) for env, a in zip(singles, actions, strict=True)]
            expected = [result[0] for result in results]
            scores = [result[4]["eval_score"] for result in results]
            np.testing.assert_array_equal(infos["eval_score"], scores)
            np.testing.assert_array_equal(truncated, [result[3] for result in results])
        np.testing.assert_array_equal(observations, np.stack(expected))
    for i, env in enumerate(singles):
        assert envs.get_state(i) == env.get_state()
    envs.close()


@pytest.mark.parametrize("observation", ["LoRes4E", "LoResStack", "LoResCHW4E"])
def test_pixels_of_mixed_tasks_are_bit_equal_to_single_environments(observation: str) -> None:
    env_ids = [f"magical/{name}-v0" for name in ("MakeLine-TestAll", "MoveToCorner-Demo")] * 2
    singles = [single(env_id, observation, horizon=3) for env_id in env_ids]
    several = [vector(env_ids, workers, observation, horizon=3) for workers in (1, 2)]
    expected: Any = tuple(env.reset(seed=i)[0] for i, env in enumerate(singles))
    found = [envs.reset(seed=0)[0] for envs in several]
    for step, actions in enumerate(actions_for(len(env_ids), 6)):
        space = several[0].single_observation_space
        batch: Any = gymnasium.vector.utils.create_empty_array(space, len(env_ids))
        batch = gymnasium.vector.utils.concatenate(space, expected, batch)
        for observations in found:
            same(observations, batch)
        if step == 3:
            expected = tuple(env.reset()[0] for env in singles)
        else:
            expected = tuple(env.step(a)[0] for env, a in zip(singles, actions, strict=True))
        found = [envs.step(actions)[0] for envs in several]
    for envs in several:
        envs.close()


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
@pytest.mark.parametrize("workers", [1, 2])
def test_autoreset_as_gymnasiums_own(mode: AutoresetMode, workers: int) -> None:
    options: dict[str, Any] = {"horizon": 3, "reward": "score"}
    env_ids = ["magical/MoveToCorner-Demo-v0"] * 3
    own = vector(env_ids, workers, autoreset_mode=mode, **options)
    makers = [partial(single, env_id, **options) for env_id in env_ids]
    plain = SyncVectorEnv(makers, autoreset_mode=mode)
    assert own.metadata["autoreset_mode"] is mode
    square = Block(Shape.SQUARE, Colour.RED, Pose(-0.7, 0.7, 0.0))
    solved: dict[str, Any] = {"scene": Scene(Pose(0.5, 0.0, 0.0), (square,))}
    same(own.reset(seed=5, options=solved), plain.reset(seed=5, options=solved))
    own.set_state(1, own.get_state(0))
    plain.envs[1].set_state(plain.envs[0].get_state())
    successes, kept = [], []
    for actions in actions_for(3, 8):
        found = own.step(actions)
        same(found, plain.step(actions))
        kept.append((found, deepcopy(found)))
        ended = found[4].get("final_info", found[4])
        successes.append(ended["is_success"].all())
    assert successes == [False, False, True, *[False] * 5]  # the first episodes are solved
    for found, before in kept:  # later steps have changed nothing
        same(found, before)
    own.close()


def test_sub_environments_with_different_horizons_are_reset_separately() -> None:
    env_ids = ["magical/MoveToRegion-Demo-v0", "magical/FixColour-Demo-v0"]
    envs = vector(env_ids, observation={"size": 8, "samples": 1})
    envs.reset(seed=0)
    ends: list[list[int]] = [[], []]
    for step in range(125):
        truncated = envs.step([0, 0])[3]
        for row in np.flatnonzero(truncated):
            ends[row].append(step)
    assert ends == [[39, 80, 121], [59, 120]]


def test_disabled_autoreset_resets_where_the_mask_is_true() -> None:
    envs = vector(MIXED, 2, horizon=3, autoreset_mode="Disabled")
    envs.reset(seed=[10, 11, 12])
    before = [envs.step([1, 1, 1])[3] for _ in range(3)]
    assert not np.any(before[:2])
    assert np.all(before[2])
    with pytest.raises(ResetNeededError, match="found none in 3 of 3"):
        envs.step([0, 0, 0])
    options = {"reset_mask": np.array([True, False, True])}
    observations, infos = envs.reset(seed=[20, None, 22], options=options)
    assert "reset_mask" in options
    np.testing.assert_array_equal(infos["_eval_score"], [True, False, True])
    np.testing.assert_array_equal(observations[2], single(MIXED[2]).reset(seed=22)[0])
    with pytest.raises(ResetNeededError, match=r"in 1 of 3: 1 \(magical/FindDupe-Demo-v0\)"):
        envs.step([0, 0, 0])
    _, _, _, truncated, infos = envs.step([0, 0, 0], active=np.array([True, False, True]))
    assert not truncated.any()
    np.testing.assert_array_equal(infos["_eval_score"], [True, False, True])
    assert [state.step for state in envs.states()] == [1, 3, 1]
    envs.close()


def test_inactive_sub_environments_do_not_change() -> None:
    envs = vector()
    before, _ = envs.reset(seed=0)
    after = envs.step([1, 1, 1], active=np.array([False, True, False]))[0]
    np.testing.assert_array_equal(np.any(before != after, axis=1), [False, True, False])


@pytest.mark.parametrize("workers", [1, 2])
def test_states_are_those_of_single_environments(workers: int) -> None:
    envs = vector(MIXED, workers, horizon=9)
    envs.reset(seed=0)
    singles = [single(env_id, horizon=9) for env_id in MIXED]
    for i, env in enumerate(singles):
        env.reset(seed=i)
    kept = envs.states()
    for actions in actions_for(3, 4):
        envs.step(actions)
        for env, action in zip(singles, actions, strict=True):
            env.step(action)
    for found, env in zip(envs.states(), singles, strict=True):
        expected = env.state()
        assert found.scene == expected.scene
        assert (found.step, found.horizon) == (4, 9)
        np.testing.assert_array_equal(found.poses.bodies, expected.poses.bodies)
        np.testing.assert_array_equal(found.velocities, expected.velocities)
    bodies, counts = envs.bodies
    np.testing.assert_array_equal(bodies[2, : counts[2], :3], singles[2].state().poses.bodies)
    assert not bodies.flags.writeable
    assert kept[0].poses.robot == kept[0].scene.robot  # what was read once stays as it was
    envs.close()


@pytest.mark.parametrize("workers", [1, 2])
def test_a_saved_state_continues_in_another_environment(workers: int) -> None:
    envs = vector(["magical/MakeLine-TestAll-v0"] * 3, workers, horizon=12)
    other = single("magical/MakeLine-TestAll-v0", horizon=12)
    envs.reset(seed=0)
    other.reset(seed=50)
    for action in (1, 10, 4, 7):
        other.step(action)
    observation = envs.set_state(2, other.get_state())
    expected_observation = single("magical/MakeLine-TestAll-v0").set_state(other.get_state())
    np.testing.assert_array_equal(observation, expected_observation)
    assert envs.get_state(2) == other.get_state()
    for action in (3, 1, 1):
        expected = other.step(action)[0]
        np.testing.assert_array_equal(envs.step([0, 0, action])[0][2], expected)
    assert envs.states()[2].scene == other.state().scene
    with pytest.raises(InvalidStateError, match="MakeLine"):
        envs.set_state(0, {**other.get_state(), "task": "FindDupe"})
    with pytest.raises(ResetNeededError, match="in 1 of 3: 0 "):
        envs.step([0, 0, 0])
    with pytest.raises(IndexError):
        envs.get_state(3)
    assert envs.get_state(-1) == other.get_state()
    envs.close()


def test_reset_takes_scenes_and_dynamics() -> None:
    dynamics = Dynamics(body_pivot_max_force=2.5)
    envs = vector(["magical/MoveToCorner-Demo-v0"] * 2)
    given = single("magical/MoveToCorner-Demo-v0").reset(seed=0)[0]
    sampled, _ = envs.reset(seed=0)
    np.testing.assert_array_equal(sampled[0], given)
    demo = envs.states()[0].scene
    moved = replace(demo, robot=Pose(0.5, 0.5, 0.0))
    envs.reset(options={"scene": moved, "dynamics": dynamics})
    assert envs.states()[0].scene == moved
    assert envs.get_state(0)["dynamics"]["body_pivot_max_force"] == 2.5
    assert envs.get_state(1)["dynamics"]["body_pivot_max_force"] == 2.5
    envs.reset(options={"scene": [demo, moved.to_dict()], "dynamics": [dynamics, Dynamics()]})
    assert [state.scene for state in envs.states()] == [demo, moved]
    assert envs.get_state(1)["dynamics"] == Dynamics().to_dict()
    with pytest.raises(ValueError, match="reset options"):
        envs.reset(options={"scenes": moved})


def test_spaces_contain_what_is_given() -> None:
    envs = vector()
    observations, _ = envs.reset(seed=0)
    assert observations in envs.observation_space
    assert envs.action_space.sample().shape == (3,)
    assert envs.single_action_space == gymnasium.spaces.Discrete(NUM_ACTIONS)
    results = envs.step(envs.action_space.sample())
    assert results[0] in envs.observation_space
    assert [array.dtype for array in results[1:4]] == [np.float64, np.bool_, np.bool_]


def test_rewards() -> None:
    envs = vector(["magical/MoveToRegion-Demo-v0"] * 2, horizon=3, reward=TO_CENTRE)
    env = single("magical/MoveToRegion-Demo-v0", horizon=3, reward=TO_CENTRE)
    envs.reset(seed=0)
    env.reset(seed=0)
    for _ in range(3):
        rewards = envs.step([1, 0])[1]
        assert rewards[0] == env.step(1)[1]
    assert rewards[0] != rewards[1]


def test_render_returns_a_frame_of_every_sub_environment() -> None:
    envs = vector(MIXED, render_mode="rgb_array")
    envs.reset(seed=0)
    frames = envs.render()
    assert frames is not None
    env = single(MIXED[1], render_mode="rgb_array")
    env.reset(seed=1)
    np.testing.assert_array_equal(frames[1], env.render())
    assert vector().render() is None


# Which observations the caller owns


@pytest.mark.parametrize("observation", ["state", "LoRes4A", "LoResStack"])
@pytest.mark.parametrize("workers", [1, 2])
def test_copies_do_not_change_after_they_are_returned(observation: str, workers: int) -> None:
    envs = vector(MIXED[:2], workers, observation, horizon=4)
    viewing = vector(MIXED[:2], 1, observation, horizon=4, copy=False)
    kept, expected = [envs.reset(seed=0)[0]], [copy_arrays(viewing.reset(seed=0)[0])]
    inactive_second = np.array([True, False])
    for step, actions in enumerate(actions_for(2, 8)):
        active = inactive_second if step == 2 else None
        kept.append(envs.step(actions, active)[0])
        expected.append(copy_arrays(viewing.step(actions, active)[0]))
    np.testing.assert_equal(kept, expected)
    envs.close()
    np.testing.assert_equal(kept, expected)


def test_arrays_for_copies_are_used_again_once_the_caller_has_released_them() -> None:
    envs = vector(observation="LoRes4A")
    envs.reset(seed=0)
    held = [envs.step([1, 1, 1])[0][1, 5:7] for _ in range(3)]
    before = [view.copy() for view in held]
    addresses = {view.ctypes.data for view in held}
    assert len(addresses) == 3
    assert envs.step([1, 1, 1])[0][1, 5:7].ctypes.data not in addresses
    np.testing.assert_equal(held, before)
    released = held.pop(1).ctypes.data
    for _ in range(3):
        assert envs.step([2, 2, 2])[0][1, 5:7].ctypes.data == released
    np.testing.assert_equal(held, [before[0], before[2]])


def test_without_copies_observations_are_the_buffers() -> None:
    envs = vector(copy=False)
    first, _ = envs.reset(seed=0)
    kept = first.copy()
    assert envs.step([1, 1, 1])[0] is first
    assert np.any(first != kept)


# Options and arguments


def test_make_vec_passes_options() -> None:
    envs: Any = gymnasium.make_vec(
        "magical/MatchRegions-TestJitter-LoRes4A-v0",
        num_envs=2,
        workers=1,
        observation="state",
        horizon=2,
        reward="score",
        autoreset_mode="SameStep",
        copy=False,
    )
    assert isinstance(envs, MagicalVectorEnv)
    assert envs.env_ids == ("magical/MatchRegions-TestJitter-v0",) * 2
    assert (envs.workers, envs.num_envs) == (1, 2)
    assert envs.spec is not None
    envs.reset(seed=0)
    envs.step([0, 0])
    assert "final_obs" in envs.step([0, 0])[4]


def test_presets_in_ids_apply_unless_an_observation_is_given() -> None:
    envs = MagicalVectorEnv(["magical/MakeLine-Demo-LoResCHW4E-v0"] * 2, workers=1)
    assert envs.single_observation_space.shape == (12, 96, 96)
    assert envs.env_ids == ("magical/MakeLine-Demo-v0",) * 2
    with pytest.raises(MismatchedSpacesError, match="LoRes4A, LoRes4E"):
        MagicalVectorEnv(["MakeLine-Demo-LoRes4A-v0", "MakeLine-Demo-LoRes4E-v0"], workers=1)


def test_state_vectors_of_several_tasks_are_refused_by_their_shapes() -> None:
    with pytest.raises(MismatchedSpacesError, match=r"found shape \(75,\) \(MakeLine\) and \(132,"):
        vector(env_ids=["MakeLine-Demo-v0", "FindDupe-Demo-v0"])


def test_wrong_options_are_refused() -> None:
    for wrong, error in (
        ({"env_ids": []}, ValueError),
        ({"env_ids": "magical/MakeLine-Demo-v0"}, ValueError),
        ({"env_ids": ["magical/MakeLine-TestLyout-v0"]}, UnknownNameError),
        ({"env_ids": [EnvId("MoveToCorner", "TestLayout")]}, UnknownNameError),
        ({"workers": -1}, ValueError),
        ({"horizon": 0}, ValueError),
        ({"reward": "sparse"}, UnknownNameError),
        ({"render_mode": "human"}, UnknownNameError),
    ):
        with pytest.raises(error):
            vector(**wrong)
    with pytest.raises(UnknownNameError, match="expected one of: NextStep, SameStep, Disabled"):
        vector(autoreset_mode="same_step")


@pytest.mark.parametrize(
    ("actions", "found"),
    [
        ([0, 0], "[0, 0]"),
        (np.zeros((1, 3), int), "<array of shape (1, 3), i64>"),
        ([0, 0, NUM_ACTIONS], "18 in row 2"),
        ([0, -1, 20], "-1 in row 1"),
        ([0.0, 0.5, 0.0], "[0.0, 0.5, 0.0]; sample or take the argmax"),
        ([True, False, True], "[True, False, True]"),
        ([[0], [0, 1], 0], "[<list of 1>, <list of 2>, 0]"),
        ("abc", "'abc'"),
        (None, "None"),
    ],
)
def test_wrong_actions_are_refused_and_nothing_happens(actions: Any, found: str) -> None:
    envs = vector()
    envs.reset(seed=0)
    message = re.escape(f"actions: expected integers from 0 to 17 of shape (3,), found {found}")
    with pytest.raises(InvalidActionError, match=message):
        envs.step(actions)
    assert [state.step for state in envs.states()] == [0, 0, 0]
    envs.step([0, 0, 0])


def test_wrong_seeds_and_masks_are_refused() -> None:
    envs = vector()
    for seed in ([1, 2], -1, 1.5, ["a", "b", "c"]):
        with pytest.raises(ValueError, match="seed: expected"):
            envs.reset(seed=seed)
    for mask in (np.zeros(3, np.bool_), np.ones(2, np.bool_), np.ones(3)):
        with pytest.raises(ValueError, match="reset_mask: expected bool"):
            envs.reset(options={"reset_mask": mask})


def test_calls_at_the_wrong_time_are_refused() -> None:
    envs = vector()
    for call in (envs.states, lambda: envs.bodies, lambda: envs.get_state(0)):
        with pytest.raises(ResetNeededError):
            call()
    with pytest.raises(
        ResetNeededError, match="step: expected a running episode in every environment"
    ):
        envs.step([0, 0, 0])
    envs.reset(options={"reset_mask": np.array([True, False, True])})
    with pytest.raises(ResetNeededError, match="in 1 of 3"):
        envs.step([0, 0, 0])
    envs.get_state(2)


def test_gymnasiums_wrappers_and_specs_work() -> None:
    options: dict[str, Any] = {"observation": "state", "horizon": 3}
    made: Any = gymnasium.make_vec("magical/MoveToCorner-Demo-v0", 2, workers=1, **options)
    again: Any = gymnasium.make_vec(made.spec)
    assert (again.num_envs, again.workers, again.env_ids) == (2, 1, made.env_ids)
    envs = gymnasium.wrappers.vector.RecordEpisodeStatistics(made)
    envs.reset(seed=0)
    for _ in range(3):
        infos = envs.step(np.array([1, 1]))[4]
    assert infos["episode"]["l"].tolist() == [3, 3]
    listed = gymnasium.wrappers.vector.DictInfoToList(again)
    start: dict[str, Any] = {"eval_score": 0.0, "published_code_score": 0.0, "is_success": False}
    start["instruction"] = "Push the red square to the top left corner."
    assert listed.reset(seed=0)[1] == [start] * 2


# Threads, and errors of tasks


def raising(scene: Any, poses: Any) -> Any:
    raise ValueError("no score today")


@pytest.fixture
def misbehaving() -> Any:
    """Registers a task with a score function."""

    def register(score_fn: Any) -> str:
        task = replace(get_task("MakeLine"), name="Misbehaving", score_fn=score_fn)
        return EnvId(register_task(task).name, "Demo")

    yield register
    unregister_task("Misbehaving")


@pytest.mark.parametrize("workers", [1, 2])
def test_an_error_names_its_environment_and_all_need_a_reset(
    misbehaving: Any, workers: int
) -> None:
    envs = vector(["MakeLine-Demo-v0", misbehaving(raising)], workers, horizon=1)
    envs.reset(seed=0)
    with pytest.raises(ValueError, match="no score today") as caught:
        envs.step([0, 0])
    assert caught.value.__notes__ == ["in environment 1 (magical/Misbehaving-Demo-v0)"]
    with pytest.raises(ResetNeededError, match="in 2 of 2"):
        envs.step([0, 0])
    envs.reset()
    envs.step([0, 0], active=np.array([True, False]))


@pytest.mark.parametrize("value", [np.nan, np.inf, -0.1, 1.5, None, "1"])
def test_scores_are_numbers_from_0_to_1(misbehaving: Any, value: Any) -> None:
    envs = vector([misbehaving(lambda scene, poses: value)], horizon=1)
    envs.reset(seed=0)
    with pytest.raises(InvalidScoreError, match=f"Misbehaving.*from 0 to 1, found {value!r}"):
        envs.step([0])


def test_threads_end_with_their_environment() -> None:
    before = set(threading.enumerate())
    envs = vector(MIXED * 2, workers=3)
    envs.reset(seed=0)
    observations = envs.step([0] * 6)[0]
    own = set(threading.enumerate()) - before
    assert 1 <= len(own) <= 2
    envs.close()
    assert not any(thread.is_alive() for thread in own)
    assert np.isfinite(observations).all()
    assert vector(MIXED, workers=7).workers == 3


FORK = """
import os
from magical.envs.vector import MagicalVectorEnv
envs = MagicalVectorEnv(["magical/MakeLine-Demo-v0"] * 2, workers=2, observation="state")
envs.reset(seed=0)
envs.step([1, 1])
if not (child := os.fork()):
    envs.step([2, 2])
    print(envs.get_state(0)["actions"], flush=True)
    os._exit(0)
os.waitpid(child, 0)
print(envs.get_state(0)["actions"])
"""


@pytest.mark.posix
def test_a_fork_steps_environments_of_its_own() -> None:
    command = [sys.executable, "-W", "ignore", "-c", FORK]
    result = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120)
    first = [1.0, 0.0, -1.0]
    assert result.stdout.splitlines() == [str([first, [-1.0, 0.0, -1.0]]), str([first])]
