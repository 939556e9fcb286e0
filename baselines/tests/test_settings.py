"""Settings of a configuration: of which type they are, and what they may be."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from magical.errors import InvalidConfigError, UnknownNameError
from magical.tasks import TASKS as REGISTRY
from magical_baselines.algorithms.bc import BCConfig
from magical_baselines.algorithms.ppo import PPOConfig

TASKS = ("MoveToRegion",)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"batches": 1e4}, "batches: expected int, found 10000.0"),
        ({"seed": True}, "seed: expected int, found True"),
        ({"anneal": "yes"}, "anneal: expected bool, found 'yes'"),
        ({"learning_rate": "1e-3"}, "learning_rate: expected float, found '1e-3'"),
        ({"learning_rate": float("inf")}, "learning_rate: expected finite numbers, found inf"),
        ({"augment": None}, "augment: expected str, found None"),
        ({"momentum": 1.0}, "momentum: expected a number from 0 to below 1, found 1.0"),
    ],
)
def test_settings_of_another_type_or_range_are_refused(
    fields: dict[str, Any], message: str
) -> None:
    with pytest.raises(InvalidConfigError, match=message):
        BCConfig.preset("quick", tasks=TASKS, demos="demos", **fields)


def test_optional_settings_may_be_none() -> None:
    assert PPOConfig.preset("quick", tasks=TASKS, workers=None).ppo.workers is None
    with pytest.raises(InvalidConfigError, match=r"workers: expected int \| null, found 'two'"):
        PPOConfig.preset("quick", tasks=TASKS, workers="two")


def test_paths_and_numbers_of_numpy_are_kept_as_plain_ones() -> None:
    given = {"demos": Path("demos"), "seed": np.int64(3), "learning_rate": np.float32(0.5)}
    plain = {"demos": "demos", "seed": 3, "learning_rate": 0.5}
    found = BCConfig.preset("quick", tasks=TASKS, **given).to_dict()
    assert found == BCConfig.preset("quick", tasks=TASKS, **plain).to_dict()
    assert {type(found[name]) for name in plain} == {str, int, float}


def test_a_misspelt_setting_is_named_before_a_missing_one() -> None:
    with pytest.raises(UnknownNameError, match="'demo'"):
        BCConfig.preset("quick", tasks=TASKS, demo="demos")


@pytest.mark.parametrize("tasks", [REGISTRY, np.array(TASKS), np.str_(*TASKS)])
def test_tasks_may_be_any_names(tasks: Any) -> None:
    found = BCConfig.preset("quick", tasks=tasks, demos="demos").tasks
    assert found == (tuple(REGISTRY) if tasks is REGISTRY else TASKS)
