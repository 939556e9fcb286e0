"""Saved states from outside: continued from, or `InvalidStateError` says why not."""

import copy
import json
import math
from collections.abc import Callable, Iterator
from contextlib import closing
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from magical.envs.env import MagicalEnv
from magical.envs.vector import MagicalVectorEnv
from magical.errors import InvalidStateError, ResetNeededError

TASK, VARIANT = "MatchRegions", "TestAll"
LONGEST_MESSAGE = 1_000
State = dict[str, Any]


def make_env() -> MagicalEnv:
    return MagicalEnv(TASK, VARIANT, observation="state")


def saved_state() -> State:
    env = make_env()
    env.reset(seed=4)
    for action in (1, 4, 13):
        env.step(action)
    state: State = json.loads(json.dumps(env.get_state()))
    return state


SAVED = saved_state()


def with_entry(path: tuple[Any, ...], value: Any) -> State:
    state = copy.deepcopy(SAVED)
    parent: Any = state
    for key in path[:-1]:
        parent = parent[key]
    parent[path[-1]] = value
    return state


WRONG: dict[str, list[tuple[tuple[Any, ...], Any]]] = {  # field in the message: path, value
    "horizon": [(("horizon",), value) for value in (-5, 0, 3.5, "120", True, 10**100)],
    "task": [(("task",), "MakeLine"), (("task",), [1])],
    "variant": [(("variant",), "TestMars"), (("variant",), None)],
    "scene": [
        *((("scene", "robot"), [x, 0, 0]) for x in (1e6, 1e308)),
        (("scene", "blocks"), []),
        (("scene", "blocks"), 5),
        (("scene", "blocks"), SAVED["scene"]["blocks"] * 10_000),
        (("scene", "blocks", 0, 0), "\x1b[31mstar"),
    ],
    "dynamics": [
        (("dynamics",), forces) for forces in ({"body_gear_max_force": -1}, {"gravity": 1.0}, None)
    ],
    "actions": [
        *((("actions",), actions) for actions in ("111", [18], [1.5], [0] * 1_000_000)),
    ],
    "rng": [
        (("rng", "bit_generator"), "MT19937"),
        (("rng", "state", "state"), -1),
        (("rng", "state", "inc"), 1 << 200),
    ],
    "bodies": [
        (("bodies",), SAVED["bodies"][:-1]),
        (("bodies",), []),
        (("bodies", 0), [0.0] * 5),
        (("bodies", 0, 0), 1e4),
        (("bodies", 1, 5), "fast"),
    ],
    "exact": [(("exact",), 1)],
    "finite": [(("scene", "robot"), [x, 0, 0]) for x in (math.inf, 10**400)],
}
DAMAGED: list[tuple[str, Any]] = [
    *((field, with_entry(*change)) for field, changes in WRONG.items() for change in changes),
    *((name, {key: value for key, value in SAVED.items() if key != name}) for name in SAVED),
    *(("saved state", value) for value in (None, [1, 2])),
]


def refusal(set_state: Callable[[Any], Any], state: Any) -> str:
    with pytest.raises(InvalidStateError) as caught:
        set_state(state)
    message = str(caught.value)
    assert len(message) <= LONGEST_MESSAGE
    assert message.isprintable()
    return message


@pytest.mark.parametrize(("field", "state"), DAMAGED)
def test_damaged_states_are_refused_and_the_field_is_named(field: str, state: Any) -> None:
    env = make_env()
    assert field in refusal(env.set_state, state)
    with pytest.raises(ResetNeededError):
        env.step(0)
    env.set_state(SAVED)
    env.step(0)
    env.reset()


def departed(shift: float = 1e-3) -> State:
    """A state as another platform might save it: after the same actions, a block is elsewhere."""
    return with_entry(("bodies", -1, 0), SAVED["bodies"][-1][0] + shift)


def test_where_the_actions_lead_elsewhere_the_saved_bodies_are_set() -> None:
    env, elsewhere = make_env(), departed()
    with pytest.warns(RuntimeWarning, match=r"led to other bodies, by up to 0\.001 units"):
        observation = env.set_state(elsewhere)
    assert env.state().bodies.tolist() == elsewhere["bodies"]
    assert np.float32(elsewhere["bodies"][-1][0]) in observation
    assert (env.get_state()["exact"], env.get_state()["actions"]) == (False, SAVED["actions"])
    env.step(1)
    env.set_state(SAVED)  # without a warning
    assert env.get_state()["exact"]
    env.reset(seed=0)
    assert env.get_state()["exact"]


def test_a_difference_in_the_last_bit_is_told() -> None:
    x = SAVED["bodies"][-1][0]
    env, elsewhere = make_env(), with_entry(("bodies", -1, 0), float(np.nextafter(x, 2.0)))
    with pytest.warns(RuntimeWarning, match=r"by up to \d(\.\d)?e-1[67] units"):
        env.set_state(elsewhere)
    assert not env.get_state()["exact"]


def test_the_vector_environment_sets_saved_bodies_as_well() -> None:
    ids = [f"{TASK}-{VARIANT}-v0"] * 2
    with closing(MagicalVectorEnv(ids, workers=1, observation="LoRes4E")) as envs:
        with pytest.warns(RuntimeWarning, match="led to other bodies"):
            stack = envs.set_state(1, departed(0.2))
        envs.set_state(0, SAVED)
        assert envs.get_state(1)["bodies"] == departed(0.2)["bodies"]
        assert [envs.get_state(row)["exact"] for row in range(2)] == [True, False]
    frames = np.split(stack, 4, axis=2)
    assert all((frame == frames[0]).all() for frame in frames)


def test_an_episode_keeps_its_variant() -> None:
    env = MagicalEnv(TASK, "Demo", observation="state")
    env.set_state(SAVED)
    assert env.get_state() == SAVED
    assert env.variant == env.env_id.variant == SAVED["variant"] != "Demo"
    env.reset(seed=0)
    assert env.variant == env.env_id.variant == env.get_state()["variant"] == "Demo"


def test_the_next_episode_has_the_environments_own_horizon() -> None:
    env = MagicalEnv(TASK, VARIANT, observation="state", horizon=5)
    env.reset(seed=0)
    envs = MagicalVectorEnv([f"{TASK}-{VARIANT}-v0"], workers=1, observation="state", horizon=7)
    envs.set_state(0, env.get_state())
    assert envs.states()[0].horizon == 5
    envs.reset(seed=0)
    assert envs.states()[0].horizon == 7
    envs.close()


def test_after_a_state_at_its_episodes_end_comes_another_episode() -> None:
    ended = {**SAVED, "horizon": len(SAVED["actions"])}
    env = make_env()
    env.set_state(ended)
    with pytest.raises(ResetNeededError):
        env.step(1)
    ids = [f"{TASK}-{VARIANT}-v0"]
    envs = MagicalVectorEnv(ids, workers=1, observation="state", autoreset_mode="NextStep")
    envs.set_state(0, ended)
    assert not envs.step([1])[3].any()
    assert (envs.states()[0].step, envs.states()[0].horizon) == (0, 120)
    envs = MagicalVectorEnv(ids, workers=1, observation="state", autoreset_mode="Disabled")
    envs.set_state(0, ended)
    with pytest.raises(ResetNeededError):
        envs.step([1])


VALUES: list[Any] = [
    *(None, True, -1, 0, 0.5, 1e6, -0.0, 5e-324, 1e308, math.nan, math.inf, 10**400),
    *("", "red", "\x1b[2J\x00", "x" * 100_000, b"star", [], {}, [[]], {"x": {}}),
    *SAVED.values(),
]


def paths(value: Any, here: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """The path to every entry of nested dicts and lists."""
    for key, entry in value.items() if isinstance(value, dict) else enumerate(value):
        yield (*here, key)
        if isinstance(entry, dict | list):
            yield from paths(entry, (*here, key))


@settings(max_examples=1000, deadline=None)
@given(
    st.sampled_from(list(paths(SAVED))),
    st.sampled_from(VALUES) | st.integers(-2, 200) | st.floats(-1.0, 4.0),
)
@pytest.mark.filterwarnings("default:set_state")  # of other bodies than the actions'
def test_any_entry_may_be_anything(path: tuple[Any, ...], value: Any) -> None:
    env, problem = make_env(), ""
    try:
        env.set_state(with_entry(path, value))
    except InvalidStateError as error:
        problem = str(error)
    if not problem:
        check_continuation(env, make_env())
    assert len(problem) <= LONGEST_MESSAGE
    assert problem == "" or problem.isprintable()


def check_continuation(env: MagicalEnv, other: MagicalEnv) -> None:
    """Another environment continues bit-equally from an accepted state, and all is finite."""
    again = other.set_state(json.loads(json.dumps(env.get_state())))
    assert other.get_state() == env.get_state()
    np.testing.assert_array_equal(env.state().poses.bodies, other.state().poses.bodies)
    if len(env.get_state()["actions"]) < env.horizon:
        again = other.step(1)[0]
        np.testing.assert_array_equal(env.step(1)[0], again)
    assert np.isfinite(again).all()
    if env.get_state()["exact"]:  # bodies that were set may not fit together, as fingers to a robot
        assert np.abs(env.state().poses.robot[:2]).max() < 1.1
