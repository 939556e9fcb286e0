"""Configurations: types and ranges of their settings, plain data, other people's classes."""

from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from baselines.tests.tiny_runs import tiny
from magical.errors import InvalidConfigError, RunFolderError, UnknownNameError
from magical.runs import CONFIG, track_of
from magical.tasks import TASKS as REGISTRY
from magical_baselines import algorithm_names, find_algorithm, read_config
from magical_baselines.algorithms.bc import BCConfig
from magical_baselines.algorithms.ppo import PPOConfig
from magical_baselines.config import option

TASKS = ("MoveToRegion",)


def quick(**fields: Any) -> BCConfig:
    return BCConfig.preset("quick", **{"tasks": TASKS, "demos": "demos", **fields})


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"batches": 1e4}, "batches: expected int, found float"),
        ({"batches": 0}, "batches: expected int >= 1"),
        ({"seed": True}, "seed: expected int, found bool"),
        ({"seed": -1}, "seed: expected int >= 0"),
        ({"anneal": "yes"}, "anneal: expected bool, found str"),
        ({"learning_rate": "1e-3"}, "learning_rate: expected float, found str"),
        ({"learning_rate": float("inf")}, "learning_rate: expected finite numbers, found inf"),
        ({"momentum": 1.0}, "momentum: expected float < 1.0"),
        ({"augment": None}, "augment: expected str, found null"),
        ({"optimizer": "lion"}, "optimizer: expected one of 'sgd', 'adam', found 'lion'"),
        ({"threads": 5000}, "threads: expected int <= 4096"),
        ({"tasks": ()}, "tasks: expected each task once"),
        ({"tasks": TASKS * 2}, "tasks: expected each task once"),
        ({"observation": "state"}, "augment: expected none"),
    ],
)
def test_settings_of_another_type_or_range_are_refused(
    fields: dict[str, Any], message: str
) -> None:
    with pytest.raises(InvalidConfigError, match=message):
        quick(**fields)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"network": "huge"}, "network 'huge' is unknown; expected one of: .*; or module:NAME"),
        ({"observation": "Fog"}, "observation 'Fog' is unknown"),
        ({"augment": "blur"}, "augmentation 'blur' is unknown"),
        ({"demo": "demos"}, "setting 'demo' is unknown; expected one of: tasks, "),
    ],
)
def test_unknown_names_are_refused_with_the_known_ones(
    fields: dict[str, Any], message: str
) -> None:
    with pytest.raises(UnknownNameError, match=message):
        quick(**fields)


def test_an_observation_that_an_algorithm_does_not_take_is_named() -> None:
    with pytest.raises(UnknownNameError, match="observation 'state' is not taken by gail"):
        tiny(find_algorithm("gail").config, observation="state")


def test_a_misspelt_setting_is_named_before_a_missing_one() -> None:
    with pytest.raises(UnknownNameError, match="'demo'"):
        BCConfig.preset("quick", tasks=TASKS, demo="demos")
    with pytest.raises(InvalidConfigError, match="expected the setting demos, found none"):
        BCConfig.preset("quick", tasks=TASKS)
    with pytest.raises(UnknownNameError, match="preset 'slow' is unknown; bc has: paper, quick"):
        BCConfig.preset("slow", tasks=TASKS, demos="demos")


def test_optional_settings_may_be_none() -> None:
    assert PPOConfig.preset("quick", tasks=TASKS, workers=None).workers is None
    with pytest.raises(InvalidConfigError, match=r"workers: expected int \| null, found str"):
        PPOConfig.preset("quick", tasks=TASKS, workers="two")


def test_paths_and_numbers_of_numpy_are_kept_as_plain_ones() -> None:
    given = {"demos": Path("demos"), "seed": np.int64(3), "learning_rate": np.float32(0.5)}
    plain = {"demos": "demos", "seed": 3, "learning_rate": 0.5}
    found = quick(**given).to_dict()
    assert found == quick(**plain).to_dict()
    assert {type(found[name]) for name in plain} == {str, int, float}


@pytest.mark.parametrize("tasks", [REGISTRY, np.array(TASKS), np.str_(*TASKS)])
def test_tasks_may_be_any_names(tasks: Any) -> None:
    assert quick(tasks=tasks).tasks == (tuple(REGISTRY) if tasks is REGISTRY else TASKS)


@pytest.mark.parametrize("algorithm", algorithm_names())
def test_configurations_are_the_same_after_plain_data(algorithm: str) -> None:
    kind = find_algorithm(algorithm).config
    for preset in kind.presets:
        config = tiny(kind, preset)
        assert kind.from_dict(config.to_dict()) == config
        assert config.replace(seed=5).seed == 5


@dataclass(frozen=True, kw_only=True)
class Named(BCConfig):
    name: str = option("", "a note")


def test_an_option_may_have_the_name_of_a_parameter() -> None:
    config = Named.preset("quick", tasks=("MakeLine",), demos="demos", name="mine")
    assert (config.name, Named.from_dict(config.to_dict())) == ("mine", config)


def test_an_algorithm_that_is_not_installed_any_more_is_named_with_the_file(tmp_path: Path) -> None:
    (tmp_path / CONFIG).write_text('{"algorithm": "gone"}')
    with pytest.raises(RunFolderError, match=r"config\.json: algorithm 'gone' is unknown"):
        read_config(tmp_path)


CHOSEN = SimpleNamespace(LEARNED_FROM=("benchmark prior",), HIDDEN=(8,), make_convolutions=print)


def test_a_network_says_what_it_was_made_from() -> None:
    found = quick(network=f"{__name__}:CHOSEN").training_details["learned_from"]
    assert found == ["demonstrations", "benchmark prior"]
    assert track_of(found) == "B"


@pytest.mark.parametrize(
    ("tasks", "horizon"),
    [
        (("MoveToRegion",), "appendix"),
        ("ClusterShape", "published"),
        (iter(("MoveToRegion", "ClusterColour")), "published"),
    ],
)
def test_the_published_horizon_is_for_tasks_that_have_two(tasks: Any, horizon: str) -> None:
    config = find_algorithm("gail").config.preset("published-code", tasks=tasks, demos="d")
    assert config.horizon == horizon
