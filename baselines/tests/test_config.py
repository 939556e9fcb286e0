"""Configurations: types and ranges of their settings, plain data, other people's classes."""

from types import SimpleNamespace

import pytest

from baselines.tests.tiny_runs import tiny
from magical.errors import InvalidConfigError, RunFolderError, UnknownNameError
from magical.runs.folder import CONFIG
from magical.runs.sources import track_of
from magical_baselines import algorithm_names, find_algorithm, read_config
from magical_baselines.algorithms.bc import BCConfig

TASKS = ("MoveToRegion",)


def quick(**fields):
    return BCConfig.preset("quick", **{"tasks": TASKS, "demos": "demos", **fields})


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"batches": 1e4}, "batches: expected int, found float"),
        ({"batches": 0}, "batches: expected int >= 1"),
        ({"seed": True}, "seed: expected int, found bool"),
        ({"learning_rate": float("inf")}, "learning_rate: expected finite numbers, found inf"),
        ({"momentum": 1.0}, "momentum: expected float < 1.0"),
        ({"augment": None}, "augment: expected str, found null"),
        ({"optimizer": "lion"}, "optimizer: expected one of 'sgd', 'adam', found 'lion'"),
        ({"tasks": TASKS * 2}, "tasks: expected each task once"),
        ({"observation": "state"}, "augment: expected none"),
    ],
)
def test_settings_of_another_type_or_range_are_refused(fields, message):
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
def test_unknown_names_are_refused_with_the_known_ones(fields, message):
    with pytest.raises(UnknownNameError, match=message):
        quick(**fields)


def test_a_misspelt_setting_is_named_before_a_missing_one():
    with pytest.raises(UnknownNameError, match="'demo'"):
        BCConfig.preset("quick", tasks=TASKS, demo="demos")
    with pytest.raises(InvalidConfigError, match="expected the setting demos, found none"):
        BCConfig.preset("quick", tasks=TASKS)
    with pytest.raises(UnknownNameError, match="preset 'slow' is unknown; bc has: paper, quick"):
        BCConfig.preset("slow", tasks=TASKS, demos="demos")


@pytest.mark.parametrize("algorithm", algorithm_names())
def test_configurations_are_the_same_after_plain_data(algorithm):
    kind = find_algorithm(algorithm).config
    for preset in kind.presets:
        config = tiny(kind, preset)
        assert kind.from_dict(config.to_dict()) == config
        assert config.replace(seed=5).seed == 5


def test_an_algorithm_that_is_not_installed_any_more_is_named_with_the_file(tmp_path):
    (tmp_path / CONFIG).write_text('{"algorithm": "gone"}')
    with pytest.raises(RunFolderError, match=r"config\.json: algorithm 'gone' is unknown"):
        read_config(tmp_path)


CHOSEN = SimpleNamespace(LEARNED_FROM=("benchmark prior",), HIDDEN=(8,), make_convolutions=print)


def test_a_network_says_what_it_was_made_from():
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
def test_the_published_horizon_is_for_tasks_that_have_two(tasks, horizon):
    config = find_algorithm("gail").config.preset("published-code", tasks=tasks, demos="d")
    assert config.horizon == horizon
