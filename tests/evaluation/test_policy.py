"""What policies may be, and how they are found."""

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from magical.envs import EnvId
from magical.errors import PluginError, PolicyError, UnknownNameError
from magical.evaluation import FunctionPolicy, NoopPolicy, RandomPolicy, evaluate, load_policy
from magical.evaluation.policy import is_privileged

MODULE = """
import numpy as np

class Still:
    privileged = True
    def act(self, observations, env_ids, rng):
        return np.zeros(len(env_ids), int)
    def reset(self, mask):
        pass

class Needy(Still):
    def __init__(self, network):
        pass

class Two:
    def act(self, observations, env_ids):
        pass

still = Still()
def make():
    return Still()
def make_nothing():
    return None
def function(observations, env_ids, rng):
    return np.zeros(len(env_ids), int)
number = 7
"""


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


def function(observations: object, env_ids: Any, rng: np.random.Generator) -> Any:
    return np.zeros(len(env_ids), np.int64)


class OnlyActs:
    """Has no memory, so nothing to reset."""

    observation = "nothing"

    def act(self, observations: object, env_ids: Any, rng: np.random.Generator) -> Any:
        return np.zeros(len(env_ids), np.int64)


@pytest.mark.parametrize(
    ("source", "privileged"),
    [
        *((source, False) for source in (function, OnlyActs, OnlyActs(), NoopPolicy)),
        (lambda *given: function(*given), False),
        *(("noop", False), ("random", False), ("expert", True)),
        *(("{}:still", True), ("{}:Still", True), ("{}.py:make", True)),
        ("{}:function", False),
    ],
)
def test_whatever_describes_a_policy_is_evaluated(
    module: str, source: Any, privileged: bool
) -> None:
    named = source.format(module) if isinstance(source, str) else source
    policy = load_policy(named)
    assert load_policy(policy) is policy
    assert is_privileged(policy) == privileged
    scores = evaluate(named, [EnvId("MoveToRegion", "Demo")], rollouts=2, horizon=1, workers=0)
    assert [row.rollout for row in scores] == [0, 1]


def test_a_compiled_function_without_a_signature_is_a_policy() -> None:
    assert isinstance(load_policy("builtins:max"), FunctionPolicy)


def test_a_policy_that_only_acts_keeps_all_that_it_states() -> None:
    stated = {"privileged": True, "tasks": ("MoveToRegion",), "exact": True, "modules": None}
    policy = load_policy(type("Stating", (OnlyActs,), stated)())
    assert isinstance(policy, FunctionPolicy)
    assert {name: getattr(policy, name) for name in stated} == stated


FORMS = "random, noop, expert, a run folder, module:name"


@pytest.mark.parametrize(
    ("source", "error", "message"),
    [
        (7, PolicyError, "found 7"),
        ("{}:number", PolicyError, "found 7"),
        ("{}:Needy", PolicyError, "a class or function that returns one when called without arg"),
        ("{}:Two", PolicyError, r"expected an object with act\(observations, env_ids, rng\)"),
        ("builtins:dict", PolicyError, "found <class 'dict'>"),
        ("{}:make_nothing", PolicyError, "found <function make_nothing"),
        ("{}:absent", PluginError, "no 'absent' in the module, which has: .*Still"),
        ("no_such_module:policy", PluginError, "no_such_module"),
        ("./policy:Needy", PluginError, "a path ending in .py"),
        ("no/such/file.py:policy", PluginError, "no/such/file.py"),
        ("randon", UnknownNameError, FORMS),
        ("module:", UnknownNameError, FORMS),
        (Path("runs/none"), UnknownNameError, FORMS),
    ],
)
def test_what_is_no_policy(module: str, source: Any, error: type, message: str) -> None:
    with pytest.raises(error, match=message):
        load_policy(source.format(module) if isinstance(source, str) else source)


def test_a_module_in_the_working_folder_takes_no_librarys_place(
    module: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "this.py").write_text("raise AssertionError")
    monkeypatch.delitem(sys.modules, "this", raising=False)
    load_policy(f"{module}:still")
    assert sys.path[-1] == str(tmp_path)
    with pytest.raises(PluginError, match="no 'still' in the module"):
        load_policy("this:still")
