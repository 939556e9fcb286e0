"""What policies may return, and how they are found."""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from magical.envs import EnvId
from magical.errors import PluginError, PolicyError, UnknownNameError
from magical.evaluation import (
    FunctionPolicy,
    NoopPolicy,
    Policy,
    RandomPolicy,
    evaluate,
    load_policy,
)
from magical.evaluation.policy import is_privileged

MODULE = """
import numpy as np

class Still:
    privileged = True
    def act(self, observations, env_ids, rng):
        return np.zeros(len(env_ids), int)
    def reset(self, mask):
        pass

class OnlyActs:
    act = Still.act

class Needy(Still):
    def __init__(self, network):
        pass

still = Still()
def make():
    return Still()
def make_nothing():
    return None
def function(observations, env_ids, rng):
    return np.ones(len(env_ids), int)
function.observation = "LoRes4A"
number = 7
"""

DEMO = EnvId("MoveToRegion", "Demo")


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    (tmp_path / "someones_policy.py").write_text(MODULE)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.delitem(sys.modules, "someones_policy", raising=False)
    return "someones_policy"


def test_random_policy_takes_every_action_equally_often_and_noop_none() -> None:
    actions = RandomPolicy().act(None, ["id"] * 18_000, np.random.default_rng(0))
    counts = np.bincount(actions, minlength=18)
    assert counts.size == 18
    assert ((counts > 850) & (counts < 1150)).all()
    np.testing.assert_array_equal(NoopPolicy().act(None, ["id"] * 3, np.random.default_rng(0)), 0)


@pytest.mark.parametrize("name", ["random", "noop", "expert"])
def test_built_in_policies_by_name(name: str) -> None:
    policy = load_policy(name)
    assert isinstance(policy, Policy)
    assert is_privileged(policy) == (name == "expert")


@pytest.mark.parametrize("name", ["still", "Still", "make"])
def test_objects_classes_and_factories(module: str, name: str) -> None:
    policy = load_policy(f"{module}:{name}")
    assert is_privileged(policy)
    np.testing.assert_array_equal(policy.act([], [DEMO], np.random.default_rng(0)), [0])


@pytest.mark.parametrize("suffix", ["", ".py"])
def test_a_plain_function_is_a_policy(module: str, suffix: str) -> None:
    policy = load_policy(f"{module}{suffix}:function")
    assert isinstance(policy, FunctionPolicy)
    assert policy.observation == "LoRes4A"
    assert not is_privileged(policy)
    policy.reset(np.ones(1, bool))
    np.testing.assert_array_equal(policy.act(None, [DEMO], np.random.default_rng(0)), [1])


def test_a_policy_that_only_acts_keeps_all_that_it_states() -> None:
    stated = {
        "privileged": True,
        "observation": "LoRes4A",
        "action_space": "continuous",
        "tasks": ("MoveToRegion",),
        "exact": True,
        "in_processes": True,
        "modules": None,
    }
    policy = load_policy(type("Stating", (OnlyActs,), stated)())
    assert isinstance(policy, FunctionPolicy)
    assert {name: getattr(policy, name) for name in stated} == stated


def test_a_wrapped_function_is_a_policy() -> None:
    assert isinstance(load_policy(lambda *given: function(*given)), FunctionPolicy)


def test_a_compiled_function_without_a_signature_is_a_policy() -> None:
    assert isinstance(load_policy("builtins:max"), FunctionPolicy)


def function(
    observations: object, env_ids: Sequence[str], rng: np.random.Generator
) -> NDArray[np.int64]:
    return np.zeros(len(env_ids), np.int64)


class OnlyActs:
    """Has no memory, so nothing to reset."""

    observation = "nothing"

    def act(self, observations: object, env_ids: Sequence[str], rng: np.random.Generator) -> Any:
        return np.zeros(len(env_ids), np.int64)


@pytest.mark.parametrize(
    "source",
    [
        function,
        OnlyActs,
        OnlyActs(),
        NoopPolicy,
        "noop",
        "{}:function",
        "{}:OnlyActs",
        "{}.py:make",
    ],
)
def test_python_evaluates_what_the_command_line_does(module: str, source: Any) -> None:
    named = source.format(module) if isinstance(source, str) else source
    policy = load_policy(named)
    assert load_policy(policy) is policy
    assert len(evaluate(named, [DEMO], rollouts=2, horizon=1, workers=0)) == 2


FORMS = "random, noop, expert, a run folder, module:name"


@pytest.mark.parametrize(
    ("source", "error", "message"),
    [
        (7, PolicyError, "found int 7"),
        ("{}:number", PolicyError, "found int 7"),
        ("{}:Needy", PolicyError, "class that can be instantiated without arguments"),
        ("builtins:dict", PolicyError, "class that can be instantiated without arguments"),
        ("{}:make_nothing", PolicyError, "found None"),
        ("{}:absent", PluginError, "no 'absent' in the module, which has: .*Still"),
        ("no_such_module:policy", PluginError, "no_such_module"),
        ("./policy:Needy", PluginError, "a path ending in .py"),
        ("no/such/file.py:policy", PluginError, "no/such/file.py"),
        ("randon", UnknownNameError, FORMS),
        ("module:", UnknownNameError, FORMS),
        (":name", UnknownNameError, FORMS),
        (Path("runs/none"), UnknownNameError, FORMS),
    ],
)
def test_what_is_no_policy(module: str, source: Any, error: type, message: str) -> None:
    with pytest.raises(error, match=message):
        load_policy(source.format(module) if isinstance(source, str) else source)


def test_a_module_found_elsewhere_does_not_open_the_working_folder(
    module: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    hostile = tmp_path / "hostile"
    hostile.mkdir()
    monkeypatch.chdir(hostile)
    monkeypatch.syspath_prepend(tmp_path)
    before = list(sys.path)
    load_policy(f"{module}:still")
    assert sys.path == before


def test_a_module_in_the_working_folder_takes_no_librarys_place(
    module: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "this.py").write_text("raise AssertionError")
    monkeypatch.delitem(sys.modules, "this", raising=False)
    load_policy(f"{module}:still")
    assert sys.path[-1] == str(tmp_path)
    with pytest.raises(PluginError, match="no 'still' in the module"):
        load_policy("this:still")
