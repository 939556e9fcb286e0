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
    InvalidStateError,
    InvalidTaskError,
    ObservationError,
    ResetNeededError,
    UnknownNameError,
)
from magical.scene import NUM_ACTIONS, Block, Colour, Dynamics, Pose, Scene, Shape
from magical.tasks import get_task, register_task, unregister_task

MIXED = (
    "magical/FindDupe-TestAll-v0",
    "magical/FindDupe-Demo-v0",
    "magical/FindDupe-TestDynamics-v0",
)
CORNER = "magical/MoveToCorner-Demo-v0"
HORIZON = 7


def vector(
    env_ids: Any = MIXED, workers: int = 1, observation: Any = "state", **options: Any
) -> MagicalVectorEnv:
    return MagicalVectorEnv(env_ids, workers=workers, observation=observation, **options)


def single(env_id: str, observation: Any = "state", **options: Any) -> MagicalEnv:
    parsed = parse_env_id(env_id)
    return MagicalEnv(parsed.task, parsed.variant, observation=observation, **options)


def actions_for(num_envs: int, steps: int) -> np.ndarray:
    return np.random.default_rng(0).integers(0, NUM_ACTIONS, (steps, num_envs))


def stacked(observations: list[Any]) -> Any:
    if isinstance(observations[0], dict):
        return {name: np.stack([each[name] for each in observations]) for name in observations[0]}
    return np.stack(observations)


def same(found: Any, expected: Any) -> None:
    """Hold nested results to equality in values, types and shapes."""
    assert type(found) is type(expected)
    if isinstance(expected, dict):
        assert found.keys() == expected.keys()
        for key in expected:
            same(found[key], expected[key])
    elif isinstance(expected, np.ndarray) and expected.dtype != object:
        assert found.dtype == expected.dtype
        np.testing.assert_array_equal(found, expected)
    elif isinstance(expected, tuple | list | np.ndarray):
        assert len(found) == len(expected)
        for one, other in zip(found, expected, strict=True):
            same(one, other)
    else:
        assert found == expected


TASKS = [f"magical/{name}-v0" for name in ("MakeLine-TestAll", "MoveToCorner-Demo")] * 2


@pytest.mark.parametrize(
    ("env_ids", "workers", "kind", "observation"),
    [
        (MIXED[:1], 1, "discrete", "state"),
        (MIXED * 5, 1, "continuous", "state"),
        (MIXED * 5, 3, "discrete", "state"),
        (TASKS, 1, "discrete", "LoResStack"),
        (TASKS, 2, "continuous", "LoRes4E"),
    ],
)
def test_sub_environments_are_bit_equal_to_single_environments(
    env_ids: Any, workers: int, kind: str, observation: str
) -> None:
    options = {"horizon": HORIZON, "reward": "tests.envs.test_env:TO_CENTRE", "action_space": kind}
    options["render_mode"] = "rgb_array"
    envs = vector(env_ids, workers, observation, **options)
    singles = [single(env_id, observation, **options) for env_id in env_ids]
    observations, _ = envs.reset(seed=3)
    expected = [env.reset(seed=3 + i)[0] for i, env in enumerate(singles)]
    same(observations, stacked(expected))
    kept, start = envs.states(), envs.states()[0].bodies.copy()
    envs.action_space.seed(0)
    for step in range(2 * HORIZON + 3):
        actions = envs.action_space.sample()
        observations, rewards, _, truncated, infos = envs.step(actions)
        if step % (HORIZON + 1) == HORIZON:
            expected = [env.reset()[0] for env in singles]
            assert not truncated.any()
        else:
            results = [env.step(a) for env, a in zip(singles, actions, strict=True)]
            expected = [result[0] for result in results]
            scores = [result[4]["eval_score"] for result in results]
            np.testing.assert_array_equal(infos["eval_score"], scores)
            np.testing.assert_array_equal(rewards, [result[1] for result in results])
            np.testing.assert_array_equal(truncated, [result[3] for result in results])
        same(observations, stacked(expected))
    same(envs.render()[-1], singles[-1].render())
    bodies, counts = envs.bodies
    for i, env in enumerate(singles):
        assert envs.get_state(i) == env.get_state()
        np.testing.assert_array_equal(bodies[i, : counts[i]], env.bodies)
        np.testing.assert_array_equal(envs.states()[i].bodies, env.bodies)
    np.testing.assert_array_equal(kept[0].bodies, start)  # what was read stays as it was
    assert not bodies.flags.writeable
    envs.close()


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
@pytest.mark.parametrize("workers", [1, 2])
def test_autoreset_as_gymnasiums_own(mode: AutoresetMode, workers: int) -> None:
    options: dict[str, Any] = {"horizon": 3, "reward": "score"}
    own = vector([CORNER] * 3, workers, autoreset_mode=mode, **options)
    plain = SyncVectorEnv([partial(single, CORNER, **options)] * 3, autoreset_mode=mode)
    assert own.metadata["autoreset_mode"] is mode
    square = Block(Shape.SQUARE, Colour.RED, Pose(-0.7, 0.7, 0.0))
    solved: dict[str, Any] = {"scene": Scene(Pose(0.5, 0.0, 0.0), (square,))}
    same(own.reset(seed=5, options=solved), plain.reset(seed=5, options=solved))
    ahead = single(CORNER, **options)  # by a step, so that it ends earlier
    ahead.reset(options=solved)
    ahead.step(0)
    own.set_state(1, ahead.get_state())
    plain.envs[1].set_state(ahead.get_state())
    successes, kept = [], []
    for actions in actions_for(3, 8):
        found = own.step(actions)
        same(found, plain.step(actions))
        kept.append((found, deepcopy(found)))
        successes.append(found[4].get("final_info", found[4])["is_success"].sum())
    assert successes == [0, 1, 2, *[0] * 5]  # the first episodes are solved
    for found, before in kept:  # later steps have changed nothing
        same(found, before)
    own.close()


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
    active = np.array([True, False, True])
    after, _, _, truncated, infos = envs.step([1, 1, 1], active=active)
    np.testing.assert_array_equal(np.any(observations != after, axis=1), active)
    assert not truncated.any()
    np.testing.assert_array_equal(infos["_eval_score"], [True, False, True])
    assert [state.step for state in envs.states()] == [1, 3, 1]
    envs.close()


def test_a_saved_state_continues_in_another_environment() -> None:
    make_line = "magical/MakeLine-TestAll-v0"
    envs, other = vector([make_line] * 3, 2, horizon=12), single(make_line, horizon=12)
    envs.reset(seed=0)
    other.reset(seed=50)
    for action in (1, 10, 4, 7):
        expected = other.step(action)[0]
    np.testing.assert_array_equal(envs.set_state(2, other.get_state()), expected)
    assert envs.get_state(2) == envs.get_state(-1) == other.get_state()
    for action in (3, 1, 1):
        expected = other.step(action)[0]
        np.testing.assert_array_equal(envs.step([0, 0, action])[0][2], expected)
    with pytest.raises(InvalidStateError, match="MakeLine"):
        envs.set_state(0, {**other.get_state(), "task": "FindDupe"})
    with pytest.raises(ResetNeededError, match="in 1 of 3: 0 "):
        envs.step([0, 0, 0])
    with pytest.raises(IndexError):
        envs.get_state(3)
    envs.close()


def test_reset_takes_scenes_and_dynamics() -> None:
    dynamics = Dynamics(body_pivot_max_force=2.5)
    envs = vector([CORNER] * 2)
    envs.reset(seed=0)
    demo = envs.states()[0].scene
    moved = replace(demo, robot=Pose(0.5, 0.5, 0.0))
    for scenes, forces, expected in (
        (moved, dynamics, ([moved] * 2, [dynamics] * 2)),
        ([demo, moved.to_dict()], [dynamics, Dynamics()], ([demo, moved], [dynamics, Dynamics()])),
    ):
        envs.reset(options={"scene": scenes, "dynamics": forces})
        assert [state.scene for state in envs.states()] == expected[0]
        assert [envs.envs[row].simulation.dynamics for row in range(2)] == expected[1]
    with pytest.raises(ValueError, match="reset options"):
        envs.reset(options={"scenes": moved})


# Which observations the caller owns


@pytest.mark.parametrize(("observation", "workers"), [("LoRes4A", 2), ("LoResStack", 1)])
def test_copies_do_not_change_after_they_are_returned(observation: str, workers: int) -> None:
    envs = vector(MIXED[:2], workers, observation, horizon=4)
    viewing = vector(MIXED[:2], 1, observation, horizon=4, copy=False)
    kept, view = [envs.reset(seed=0)[0]], viewing.reset(seed=0)[0]
    expected = [deepcopy(view)]
    for step, actions in enumerate(actions_for(2, 8)):
        active = np.array([True, False]) if step == 2 else None
        kept.append(envs.step(actions, active)[0])
        assert viewing.step(actions, active)[0] is view  # without copies, always the same
        expected.append(deepcopy(view))
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


# Options and arguments


def test_gymnasium_makes_remakes_and_wraps_them() -> None:
    options: dict[str, Any] = {"observation": "state", "horizon": 3, "autoreset_mode": "SameStep"}
    made: Any = gymnasium.make_vec("magical/MoveToCorner-Demo-LoRes4A-v0", 2, workers=1, **options)
    again: Any = gymnasium.make_vec(made.spec)
    assert isinstance(again, MagicalVectorEnv)
    assert (again.num_envs, again.workers, again.env_ids) == (2, 1, (CORNER,) * 2)
    envs = gymnasium.wrappers.vector.RecordEpisodeStatistics(made)
    assert envs.reset(seed=0)[0] in envs.observation_space
    for _ in range(3):
        infos = envs.step(envs.action_space.sample())[4]
    assert infos["episode"]["l"].tolist() == [3, 3]
    listed = gymnasium.wrappers.vector.DictInfoToList(again)
    start: dict[str, Any] = {"eval_score": 0.0, "published_code_score": 0.0, "is_success": False}
    start["instruction"] = "Push the red square to the top left corner."
    assert listed.reset(seed=0)[1] == [start] * 2


def test_presets_in_ids_apply_unless_an_observation_is_given() -> None:
    envs = MagicalVectorEnv(["magical/MakeLine-Demo-LoResCHW4E-v0"] * 2, workers=1)
    assert envs.single_observation_space.shape == (12, 96, 96)
    assert envs.env_ids == ("magical/MakeLine-Demo-v0",) * 2


MAKE_LINE = "MakeLine-Demo-v0"
TWO_PRESETS = ["MakeLine-Demo-LoRes4A-v0", "MakeLine-Demo-LoRes4E-v0"]


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"env_ids": []}, ValueError, "expected a list"),
        ({"env_ids": MAKE_LINE}, ValueError, "expected a list"),
        ({"env_ids": [EnvId("MoveToCorner", "TestLayout")]}, UnknownNameError, "TestJitter"),
        ({"env_ids": TWO_PRESETS, "observation": None}, ObservationError, "LoRes4A, LoRes4E"),
        ({"env_ids": [MAKE_LINE, MIXED[1]]}, ObservationError, r"\(75,\) \(MakeLine\) and"),
        ({"workers": -1}, ValueError, "workers"),
        ({"horizon": 0}, ValueError, "horizon"),
        ({"autoreset_mode": "same_step"}, UnknownNameError, "NextStep or SameStep or Disabled"),
    ],
)
def test_wrong_options_are_refused(options: Any, error: Any, message: str) -> None:
    with pytest.raises(error, match=message):
        vector(**options)


@pytest.mark.parametrize(
    ("kind", "actions", "found"),
    [
        ("discrete", [0, 0], "[0, 0]"),
        ("discrete", np.zeros((1, 3), int), "<array of shape (1, 3), i64>"),
        ("discrete", [0, -1, 20], "-1 in row 1"),
        ("discrete", [0.0, 0.5, 0.0], "[0.0, 0.5, 0.0]; sample or take the argmax"),
        ("discrete", [[0], [0, 1], 0], "[<list of 1>, <list of 2>, 0]"),
        ("discrete", None, "None"),
        ("continuous", [[0, 0, 0], [0, 0, np.nan], [0, 0, 0]], "grip nan in row 1"),
    ],
)
def test_wrong_actions_are_refused_and_nothing_happens(kind: Any, actions: Any, found: str) -> None:
    envs = vector(action_space=kind)
    envs.reset(seed=0)
    with pytest.raises(InvalidActionError, match=r"shape \(3,.*, found " + re.escape(found)):
        envs.step(actions)
    assert [state.step for state in envs.states()] == [0, 0, 0]
    envs.step(envs.action_space.sample())


def test_wrong_seeds_and_masks_are_refused() -> None:
    envs = vector()
    for seed in ([1, 2], -1, 1.5, ["a", "b", "c"]):
        with pytest.raises(ValueError, match="seed: expected"):
            envs.reset(seed=seed)
    for mask in (np.zeros(3, np.bool_), np.ones(2, np.bool_), np.ones(3)):
        with pytest.raises(ValueError, match="reset_mask: expected bool"):
            envs.reset(options={"reset_mask": mask})


def test_calls_before_the_first_reset_are_refused() -> None:
    envs = vector()
    for call in (envs.states, lambda: envs.bodies, partial(envs.get_state, 0)):
        with pytest.raises(ResetNeededError):
            call()
    with pytest.raises(ResetNeededError, match="step: expected a running episode in every"):
        envs.step([0, 0, 0])


# Threads, and errors of tasks


def raising(scene: Any, poses: Any) -> Any:
    raise ValueError("no score today")


@pytest.mark.parametrize(
    ("score_fn", "error", "message"),
    [
        (raising, ValueError, "no score today"),
        *(
            (lambda *_, v=value: v, InvalidTaskError, f"Misbehaving.*from 0 to 1, found {value!r}")
            for value in (np.nan, -0.1, 1.5, None, "1")
        ),
    ],
)
def test_an_error_names_its_environment_and_all_need_a_reset(
    score_fn: Any, error: Any, message: str
) -> None:
    register_task(replace(get_task("MakeLine"), name="Misbehaving", score_fn=score_fn))
    try:
        envs = vector([MAKE_LINE, EnvId("Misbehaving", "Demo")], 2, horizon=1)
        envs.reset(seed=0)
        with pytest.raises(error, match=message) as caught:
            envs.step([0, 0])
        assert caught.value.__notes__ == ["in environment 1 (magical/Misbehaving-Demo-v0)"]
        with pytest.raises(ResetNeededError, match="in 2 of 2"):
            envs.step([0, 0])
        envs.reset()
        envs.step([0, 0], active=np.array([True, False]))
    finally:
        unregister_task("Misbehaving")


def test_threads_end_with_their_environment() -> None:
    before = set(threading.enumerate())
    envs = vector(MIXED * 2, workers=3)
    envs.reset(seed=0)
    envs.step([0] * 6)
    own = set(threading.enumerate()) - before
    assert 1 <= len(own) <= 2
    envs.close()
    assert not any(thread.is_alive() for thread in own)
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
