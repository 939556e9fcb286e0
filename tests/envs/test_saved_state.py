"""Saved states from outside: continued from, or an error says why not."""

import copy
import json
import math
from collections.abc import Iterator
from contextlib import closing
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from magical.envs.env import MagicalEnv
from magical.envs.vector import MagicalVectorEnv
from magical.errors import InvalidSceneError, InvalidStateError, ResetNeededError
from magical.scene import to_continuous

TASK, VARIANT = "MatchRegions", "TestAll"
LONGEST_MESSAGE = 1_000
State = dict[str, Any]


def make_env(variant: str = VARIANT, **options: Any) -> MagicalEnv:
    return MagicalEnv(TASK, variant, **{"observation": "state", **options})


def make_envs(count: int = 1, **options: Any) -> MagicalVectorEnv:
    ids = [f"{TASK}-{VARIANT}-v0"] * count
    return MagicalVectorEnv(ids, **{"workers": 1, "observation": "state", **options})


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


def departed(shift: float = 1e-3) -> State:
    """A state as another platform might save it: after the same actions, a block is elsewhere."""
    return with_entry(("bodies", -1, 0), SAVED["bodies"][-1][0] + shift)


@pytest.mark.parametrize(
    ("field", "path", "value"),
    [
        ("horizon", ("horizon",), 0),
        ("task", ("task",), "MakeLine"),
        ("variant", ("variant",), "TestMars"),
        ("scene", ("scene", "robot"), [1e6, 0, 0]),
        ("scene", ("scene", "blocks"), SAVED["scene"]["blocks"] * 1000),
        ("scene", ("scene", "blocks", 0, 0), "\x1b[31mstar"),
        ("dynamics", ("dynamics",), {"body_gear_max_force": -1}),
        ("actions", ("actions",), [[0.0] * 3] * 1000),
        ("actions", ("actions",), [1.5]),
        ("rng", ("rng", "bit_generator"), "MT19937"),
        ("rng", ("rng", "state", "inc"), 1 << 200),
        ("bodies", ("bodies",), SAVED["bodies"][:1]),
        ("bodies", ("bodies", 0, 0), 1e4),
        ("exact", ("exact",), 1),
        ("finite", ("scene", "robot"), [math.inf, 0, 0]),
        ("state", (), None),
    ],
)
def test_damaged_states_are_refused_and_the_field_is_named(
    field: str, path: tuple[Any, ...], value: Any
) -> None:
    env = make_env()
    with pytest.raises(InvalidStateError, match=field):
        env.set_state(with_entry(path, value) if path else value)
    with pytest.raises(ResetNeededError):
        env.step(0)
    env.set_state(SAVED)
    env.step(0)


def test_where_the_actions_lead_elsewhere_the_saved_bodies_are_set() -> None:
    env, elsewhere = make_env(), departed()
    with pytest.warns(RuntimeWarning, match=r"led to other bodies, by up to 0\.001 units"):
        observation = env.set_state(elsewhere)
    assert env.state().bodies.tolist() == elsewhere["bodies"]
    assert np.float32(elsewhere["bodies"][-1][0]) in observation
    assert (env.get_state()["exact"], env.get_state()["actions"]) == (False, SAVED["actions"])
    env.set_state(SAVED)  # without a warning
    assert env.get_state()["exact"]
    last_bit = float(np.nextafter(SAVED["bodies"][-1][0], 2.0))
    with pytest.warns(RuntimeWarning, match=r"by up to \d(\.\d)?e-1[67] units"):
        env.set_state(with_entry(("bodies", -1, 0), last_bit))
    env.reset(seed=0)
    assert env.get_state()["exact"]


def test_the_vector_environment_sets_saved_bodies_as_well() -> None:
    with closing(make_envs(2, observation="LoRes4E")) as envs:
        with pytest.warns(RuntimeWarning, match="led to other bodies"):
            stack = envs.set_state(1, departed(0.2))
        envs.set_state(0, SAVED)
        assert envs.get_state(1)["bodies"] == departed(0.2)["bodies"]
        assert [envs.get_state(row)["exact"] for row in range(2)] == [True, False]
    frames = np.split(stack, 4, axis=2)
    assert all((frame == frames[0]).all() for frame in frames)


def test_saved_states_continue_in_the_other_action_space() -> None:
    env, discrete = make_env(action_space="continuous"), make_env()
    discrete.set_state(SAVED)
    env.set_state(SAVED)
    assert env.get_state() == discrete.get_state() == SAVED
    assert SAVED["actions"] == to_continuous([1, 4, 13]).tolist()
    env.step([0.3, -0.2, 0.5])
    discrete.set_state(env.get_state())
    np.testing.assert_array_equal(env.step([1.0, 1.0, -1.0])[0], discrete.step(4)[0])


def test_the_next_episode_is_of_the_environment_s_own_variant_horizon_and_generator() -> None:
    env = make_env("Demo", horizon=7)
    env.set_state(SAVED)
    assert env.variant == env.env_id.variant == SAVED["variant"] != "Demo"
    assert env.state().horizon == SAVED["horizon"] != 7
    env.reset()
    assert (env.variant, env.get_state()["variant"], env.state().horizon) == ("Demo", "Demo", 7)
    first, second = make_env(), make_env()
    for each in (first, second):
        each.reset(seed=len(SAVED))
        each.set_state(SAVED)
    assert np.array_equal(first.reset()[0], second.reset()[0])


def test_after_a_state_at_its_episodes_end_comes_another_episode() -> None:
    ended = {**SAVED, "horizon": len(SAVED["actions"])}
    env = make_env()
    env.set_state(ended)
    with pytest.raises(ResetNeededError):
        env.step(1)
    envs = make_envs(autoreset_mode="NextStep")
    envs.set_state(0, ended)
    assert not envs.step([1])[3].any()
    assert (envs.states()[0].step, envs.states()[0].horizon) == (0, 120)
    envs = make_envs(autoreset_mode="Disabled")
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


@pytest.fixture(scope="module")
def pair() -> list[MagicalEnv]:
    return [make_env(), make_env()]


@settings(max_examples=300, deadline=None)
@given(
    st.sampled_from(list(paths(SAVED))),
    st.sampled_from(VALUES) | st.integers(-2, 200) | st.floats(-1.0, 4.0),
)
@pytest.mark.filterwarnings("ignore:set_state")  # of other bodies than the actions'
def test_any_entry_may_be_anything(
    pair: list[MagicalEnv], path: tuple[Any, ...], value: Any
) -> None:
    """A state is refused in a line, or another environment continues from it bit-equally."""
    (env, other), problem = pair, ""
    try:
        env.set_state(with_entry(path, value))
    except (InvalidStateError, InvalidSceneError) as error:
        problem = str(error)
    assert len(problem) <= LONGEST_MESSAGE
    if problem:
        assert problem.isprintable()
        return
    again = other.set_state(json.loads(json.dumps(env.get_state())))
    assert other.get_state() == env.get_state()
    if len(env.get_state()["actions"]) < env.horizon:
        again = other.step(1)[0]
        np.testing.assert_array_equal(env.step(1)[0], again)
    assert np.isfinite(again).all()
